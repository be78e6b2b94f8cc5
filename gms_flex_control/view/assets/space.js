/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {Arm} from './arm.js';
import {clamp, colour} from './numbers.js';
import {svg} from './shapes.js';

const VIEW = [0.6, 0.35]; // yaw and pitch of who looks [rad]
const TURN = 0.01;        // for a pixel [rad]
const STEP = 0.1;         // for a key [rad]
const KEYS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
const ROOM = 0.75;        // of the box's diagonal: its corners are hardly ever reached
const CIRCLE = Array.from({length: 25}, (_, k) => k * Math.PI / 12);

const add = (a, b, factor = 1) => a.map((value, i) => value + factor * b[i]);
const times = (matrix, v) => matrix.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
const product = (a, b) => a.map((row) => [0, 1, 2].map(
  (k) => row[0] * b[0][k] + row[1] * b[1][k] + row[2] * b[2][k]));

/* Where each joint is and how it is turned, by the angles of all; the tip at last. */
export function chain({rotation, position, prismatic, tip}, angles) {
  let turned = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], at = [0, 0, 0];
  const joints = rotation.map((own, j) => {
    const cos = Math.cos(angles[j]), sin = Math.sin(angles[j]);
    at = add(at, times(turned, position[j]));
    turned = product(turned, own);
    if (prismatic[j]) at = add(at, times(turned, [0, 0, angles[j]]));
    else turned = product(turned, [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]);
    return {at, turned};
  });
  return [...joints, {at: add(at, times(turned, tip)), turned}];
}

/* A point as [right, up, away] of who looks from a yaw and a pitch. */
export function seen([x, y, z], [yaw, pitch]) {
  const away = y * Math.cos(yaw) - x * Math.sin(yaw);
  return [x * Math.cos(yaw) + y * Math.sin(yaw), z * Math.cos(pitch) + away * Math.sin(pitch),
          away * Math.cos(pitch) - z * Math.sin(pitch)];
}

/* The robot in space as a stick figure that turns with the mouse and the arrow keys. */
export class SpaceArm extends Arm {
  parts() {
    this.view = VIEW.slice();
    const bone = (j) => svg('polyline', {
      class: 'bone', 'data-link': j, 'stroke-width': 0.55 * this.radius,
      style: `--joint: var(${j < 0 ? '--base-edge' : colour(j)})`});
    this.bones = [bone(-1), ...this.scene.joints.map((_, j) => bone(j))];
    this.joints = this.scene.joints.map((name, j) => {
      const wedge = svg('polygon', {class: 'wedge'});
      const hub = svg('polygon', {class: 'hoop', 'stroke-width': 0.16 * this.radius});
      return {wedge, hub, group: svg('g', {style: `--joint: var(${colour(j)})`, 'data-joint': name},
        hub, wedge)};
    });
    this.ground = svg('path', {class: 'ground', 'stroke-width': 0.06 * this.radius});
    this.shadow = svg('polyline', {class: 'shadow', 'stroke-width': 0.4 * this.radius});
    this.solid = svg('g');
    this.world.append(this.ground, this.shadow, this.trail, this.solid);
  }

  build(place) {
    super.build(place);
    const {picture} = this;
    picture.classList.add('space');
    picture.setAttribute('tabindex', '0');
    picture.setAttribute('aria-label', 'the arm; drag or arrow keys turn it, double click resets');
    picture.addEventListener('pointerdown', (event) => {
      this.from = [event.clientX, event.clientY];
      picture.setPointerCapture(event.pointerId);
    });
    picture.addEventListener('pointermove', (event) => {
      if (!this.from) return;
      this.turn(TURN * (this.from[0] - event.clientX), TURN * (event.clientY - this.from[1]));
      this.from = [event.clientX, event.clientY];
    });
    for (const end of ['pointerup', 'pointercancel'])
      picture.addEventListener(end, () => { this.from = null; });
    picture.addEventListener('dblclick', () => { this.view = VIEW.slice(); this.turn(0, 0); });
    picture.addEventListener('keydown', (event) => {
      if (!KEYS[event.key] || event.shiftKey) return;
      event.preventDefault();
      event.stopPropagation();
      this.turn(...KEYS[event.key].map((way) => STEP * way));
    });
  }

  turn(yaw, pitch) {
    this.view = [this.view[0] + yaw, clamp(this.view[1] + pitch, -Math.PI / 2, Math.PI / 2)];
    this.again();
  }

  /* A box of all positions, turned about its middle; orthographic, so that no view leaves it. */
  fullRoom() {
    const {position, tip} = this.scene.frames;
    const reach = [...position, tip].reduce((sum, one) => sum + Math.hypot(...one), 0);
    return [-reach, -reach, 0, reach, reach, reach];
  }

  frameRoom(room) {
    const low = room.slice(0, 3), high = room.slice(3);
    this.middle = add(low, high).map((value) => value / 2);
    const half = ROOM * Math.hypot(...add(high, low, -1)) / 2;
    super.frameRoom([-1.2 * half, -half, 1.2 * half, half]);
    this.room = room;
  }

  makeRoom(frame) {
    const points = this.places(frame, 'link').map(({at}) => at), room = this.room.slice();
    for (let i = 0; i < 3; i++) {
      room[i] = Math.min(room[i], ...points.map((point) => point[i]));
      room[i + 3] = Math.max(room[i + 3], ...points.map((point) => point[i]));
    }
    if (room.some((value, k) => value !== this.room[k])) this.frameRoom(room);
  }

  places(frame, signal) {
    return chain(this.scene.frames, this.scene.joints.map((_, j) => this.angle(frame, signal, j)));
  }

  seen(point) { return seen(add(point, this.middle, -1), this.view); }

  text(points) {
    return points.map((point) => this.seen(point).slice(0, 2).map((value) => value.toFixed(5)).join())
      .join(' ');
  }

  corners(frame, signal) {
    return [[0, 0, 0], ...this.places(frame, signal).map(({at}) => at)].map(
      (point) => this.seen(point).slice(0, 2));
  }

  pose(frame) {
    const places = this.places(frame, 'link'), depth = [];
    const points = [[0, 0, 0], ...places.map(({at}) => at)];
    this.bones.forEach((bone, k) => {
      bone.setAttribute('points', this.text([points[k], points[k + 1]]));
      depth.push([this.seen(points[k])[2] + this.seen(points[k + 1])[2], bone]);
    });
    this.joints.forEach(({hub, wedge, group}, j) => {
      const {at, turned} = places[j], torsion = this.factor * frame(`torsion.${j}`);
      const rim = (radius, angle) => add(at, times(turned, [
        radius * Math.cos(angle), radius * Math.sin(angle), 0]));
      hub.setAttribute('points', this.text(CIRCLE.map((angle) => rim(this.radius, angle))));
      const shown = Number.isFinite(torsion) && !this.scene.rigid[j]
        && !this.scene.frames.prismatic[j] ? clamp(torsion, -6.2, 6.2) : 0;
      wedge.setAttribute('points', this.text([at, ...CIRCLE.map((_, k) =>
        rim(1.7 * this.radius, shown * k / (CIRCLE.length - 1)))]));
      depth.push([2 * this.seen(at)[2] - this.radius, group]);
    });
    depth.sort((a, b) => b[0] - a[0]);
    this.solid.append(...depth.map(([, part]) => part));
    this.shadow.setAttribute('points', this.text(points.map(([x, y]) => [x, y, 0])));
    this.drawGround();
  }

  drawGround() {
    const [left, near, , right, far] = this.room, lines = [];
    const pitch = Math.max(right - left, far - near) / 8 || 1;
    const first = (value) => Math.floor(value / pitch), last = (value) => Math.ceil(value / pitch);
    for (let i = first(left); i <= last(right); i++)
      lines.push([[i, first(near)], [i, last(far)]]);
    for (let i = first(near); i <= last(far); i++)
      lines.push([[first(left), i], [last(right), i]]);
    this.ground.setAttribute('d', lines.map((line) => 'M' + this.text(
      line.map(([x, y]) => [pitch * x, pitch * y, 0])).replace(' ', 'L')).join(''));
  }
}
