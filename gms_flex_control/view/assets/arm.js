/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {calm, colour, element, fixed, format, niceFactor} from './numbers.js';
import {base, joint, linkPath, rotate, svg} from './shapes.js';

const TRAIL = 1.5;       // of the tip [s]
const TRAIL_POINTS = 50;
const FACTORS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
const WOUND = 1.5;       // the largest torsion is drawn as at most this [rad]

/* The robot as a drawing that follows frames. */
export class Arm {
  constructor(place, words, session, has) {
    this.has = has;
    this.scene = session.scene;
    this.words = words;
    this.n = this.scene.joints.length;
    this.chain = this.scene.kind !== 'decoupled';
    this.largest = session.torsion || 0;
    this.automatic = true;
    this.factor = niceFactor(this.largest, WOUND);
    this.room = session.extent && this.chain ? session.extent.slice() : null;
    const mean = this.scene.length.reduce((sum, one) => sum + one, 0) / this.n;
    this.mean = mean;
    this.radius = mean * Math.min(0.18 + 0.025 * Math.max(0, this.n - 2), 0.27);
    this.build(place);
    this.choose();
  }

  build(place) {
    this.ghost = svg('g', {class: 'ghost'});
    this.trail = svg('path', {class: 'trail'});
    this.world = svg('g', {transform: 'scale(1 -1)'});
    this.ghosts = [svg('polyline')];
    this.parts();
    this.ghost.append(...this.ghosts);
    this.world.append(this.ghost);
    this.picture = svg('svg', {role: 'img', 'aria-label': 'the arm', id: 'picture'}, this.world);
    this.scale = svg('g', {class: 'scale'});
    this.picture.append(this.scale);
    place.replaceChildren(this.picture);
    this.frameRoom(this.room || this.fullRoom());
  }

  /* Base, joints and links, which turn in one plane. */
  parts() {
    this.joints = [];
    let inner = this.world;
    this.spots = this.spread();
    for (let j = 0; j < this.n; j++) {
      const {group, turn} = joint(this.radius, this.scene.rigid[j], colour(j));
      const link = svg('path', {class: 'link', d: linkPath(this.scene.length[j], this.radius),
                                style: `--joint: var(${colour(j)})`});
      const turned = svg('g', {class: 'turned', 'data-joint': this.scene.joints[j]}, link, group);
      const moved = svg('g', {transform: `translate(${this.spots[j][0]} ${this.spots[j][1]})`});
      if (!this.chain || j === 0) this.world.append(svg('g', {
        transform: moved.getAttribute('transform')}, base(this.radius)));
      moved.append(turned);
      if (j === 0) this.world.append(this.trail);
      (this.chain ? inner : this.world).append(moved);
      inner = turned;
      this.joints.push({turned, turn});
    }
    if (!this.chain) this.ghosts = this.spots.map(() => svg('polyline'));
  }

  /* Where each joint sits: at the end of the link before, or axes side by side. */
  spread() {
    const length = this.scene.length;
    if (this.chain) return length.map((_, j) => [j ? length[j - 1] : 0, 0]);
    const across = Math.ceil(Math.sqrt(this.n)), pitch = 2.7 * Math.max(...length);
    return length.map((_, j) => [pitch * (j % across), -pitch * Math.floor(j / across)]);
  }

  fullRoom() {
    const reach = this.scene.length.reduce((sum, one) => sum + one, 0);
    if (this.chain) return [-0.25 * reach, -0.75 * reach, reach, 0.75 * reach];
    const one = Math.max(...this.scene.length);
    return [-one, Math.min(...this.spots.map((spot) => spot[1])) - one,
            Math.max(...this.spots.map((spot) => spot[0])) + one, one];
  }

  frameRoom(room) {
    this.room = room;
    const margin = 2.6 * this.radius;
    const [left, bottom, right, top] = room;
    const width = right - left + 2 * margin, height = top - bottom + 2 * margin;
    this.picture.setAttribute('viewBox', `${left - margin} ${-top - margin} ${width} ${height}`);
    this.picture.style.aspectRatio = `${width} / ${height}`;
    const bar = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5].filter((one) => one < 0.3 * width).pop()
      || 0.01;
    const x = left - margin + 0.03 * width, y = -bottom + margin - 0.03 * height;
    const size = 0.032 * Math.max(width, 0.8 * height), tick = 0.3 * size;
    this.scale.style.display = this.chain ? '' : 'none';
    this.scale.replaceChildren(
      svg('path', {d: `M${x} ${y - tick}V${y}H${x + bar}V${y - tick}`}),
      svg('text', {x: x + bar + 0.5 * size, y, 'font-size': size}));
    this.scale.lastChild.textContent = this.scene.known ? `${bar} m` : 'lengths not known';
  }

  /* The choice of how much the torsion is enlarged. */
  choose() {
    const flexible = this.scene.rigid.some((one) => !one);
    const key = (name, text) => element('span', {class: 'entry'}, element('span', {
      class: `key ${name}`}), text);
    const parts = [key('link', 'link')];
    if (flexible && !this.scene.frames) parts.push(key('motor', 'motor'));
    if (this.has('reference')) parts.push(key('ghost', 'reference'));
    if (flexible) {
      this.select = element('select', {'aria-label': 'enlargement of the spring deflection', id: 'factor'},
        element('option', {value: 'auto'}, 'auto'),
        ...FACTORS.map((one) => element('option', {value: String(one)}, `× ${one}`)));
      this.select.addEventListener('change', () => {
        this.automatic = this.select.value === 'auto';
        this.factor = this.automatic ? niceFactor(this.largest, WOUND) : Number(this.select.value);
        this.sayFactor();
        this.again();
      });
      parts.push(key('wound', element('label', {}, 'spring deflection, drawn ', this.select)));
    } else parts.push(element('span', {}, 'all joints are rigid'));
    this.words.replaceChildren(...parts);
    this.sayFactor();
  }

  sayFactor() {
    if (this.select) this.select.options[0].textContent = `× ${this.factor} (auto)`;
  }

  again() { if (this.last) this.show(...this.last); }

  /* Draw a frame; `past` gives frames of the last moments, for the trail. */
  show(frame, time, past) {
    this.last = [frame, time, past];
    for (let j = 0; j < this.n; j++) {
      const torsion = Math.abs(frame(`torsion.${j}`));
      if (torsion > this.largest) this.outgrow(torsion);
    }
    this.pose(frame);
    this.showGhost(frame);
    this.showTrail(time, past);
  }

  pose(frame) {
    for (let j = 0; j < this.n; j++) {
      const torsion = frame(`torsion.${j}`);
      this.joints[j].turned.setAttribute('transform', rotate(this.angle(frame, 'link', j)));
      this.joints[j].turn(this.factor * torsion, Math.abs(torsion) / (this.largest || 1));
    }
  }

  outgrow(torsion) {
    this.largest = torsion;
    const factor = niceFactor(torsion, WOUND);
    if (this.automatic && factor !== this.factor) {
      this.factor = factor;
      this.sayFactor();
    }
  }

  angle(frame, signal, j) {
    const value = frame(`${signal}.${j}`);
    return (Number.isFinite(value) ? value : 0) + this.scene.offset[j];
  }

  /* Corners of the chain, the base first. */
  corners(frame, signal) {
    let angle = 0, x = 0, y = 0;
    const found = [[0, 0]];
    for (let j = 0; j < this.n; j++) {
      angle += this.angle(frame, signal, j);
      x += this.scene.length[j] * Math.cos(angle);
      y += this.scene.length[j] * Math.sin(angle);
      found.push([x, y]);
    }
    return found;
  }

  showGhost(frame) {
    const known = Number.isFinite(frame('reference.0'));
    this.ghost.style.display = known ? '' : 'none';
    if (!known) return;
    const lines = this.chain ? [this.corners(frame, 'reference')] : this.spots.map(([x, y], j) => {
      const angle = this.angle(frame, 'reference', j), length = this.scene.length[j];
      return [[x, y], [x + length * Math.cos(angle), y + length * Math.sin(angle)]];
    });
    lines.forEach((line, k) => this.ghosts[k].setAttribute(
      'points', line.map((corner) => corner.map((v) => v.toFixed(5)).join(',')).join(' ')));
  }

  showTrail(time, past) {
    if (!this.chain || calm.matches || !past) {
      this.trail.setAttribute('d', '');
      return;
    }
    const points = [];
    for (let k = TRAIL_POINTS; k >= 0; k--) {
      const frame = past(time - TRAIL * k / TRAIL_POINTS);
      if (frame) points.push(this.corners(frame, 'link').pop());
    }
    this.trail.setAttribute('d', points.map(([x, y], k) => (k ? 'L' : 'M')
      + x.toFixed(5) + ' ' + y.toFixed(5)).join(''));
  }

  /* Enough room for a pose that leaves what is shown; live nobody knows it beforehand. */
  makeRoom(frame) {
    if (!this.chain) return;
    const room = this.room.slice();
    for (const [x, y] of this.corners(frame, 'link')) {
      room[0] = Math.min(room[0], x); room[1] = Math.min(room[1], y);
      room[2] = Math.max(room[2], x); room[3] = Math.max(room[3], y);
    }
    if (room.some((value, k) => value !== this.room[k])) this.frameRoom(room);
  }
}

const COLUMNS = [['link', 'link', 'rad', 1, 4], ['error', 'error', 'mrad', 1e3, 2],
                 ['torsion', 'spring', 'mrad', 1e3, 1], ['command', 'torque', 'N m', 1, 3],
                 ['friction', 'friction', 'N m', 1, 3]];

/* The numbers of the moment, a row for each joint. */
export class JointTable {
  constructor(table, session, has) {
    this.columns = COLUMNS.filter(([signal]) => has(signal) || signal === 'link');
    const {units} = session.scene;
    const head = [['joint', ''], ...this.columns.map(([, title, unit]) => [title, units[unit]])];
    const body = element('tbody');
    this.cells = session.scene.joints.map((name, j) => {
      const row = element('tr', {}, element('th', {scope: 'row'}, element('span', {
        class: 'dot', style: `background: var(${colour(j)})`}), name));
      const cells = this.columns.map(() => element('td', {class: 'number'}, '–'));
      row.append(...cells);
      body.append(row);
      return cells;
    });
    this.rigid = session.scene.rigid;
    table.replaceChildren(element('thead', {}, element('tr', {}, ...head.map(([text, unit], k) =>
      element('th', {scope: 'col', class: k ? 'number' : ''}, text, element('small', {}, unit))))),
    body);
  }

  show(frame) {
    this.cells.forEach((cells, j) => cells.forEach((cell, k) => {
      const [signal, , , factor, places] = this.columns[k];
      cell.textContent = signal === 'torsion' && this.rigid[j] ? 'rigid'
        : fixed(frame(`${signal}.${j}`) * factor, places);
    }));
  }
}

/* The same as a sentence, for those who do not see it. */
export function sentence(session, frame, time) {
  const {joints: names, units} = session.scene;
  const joints = names.map((name, j) => {
    const error = frame(`error.${j}`);
    return `${name} at ${format(frame(`link.${j}`), 3)} ${units.rad}`
      + (Number.isFinite(error) ? `, error ${fixed(1e3 * error, 2)} ${units.mrad}` : '');
  });
  return `${time.toFixed(3)} s: ${joints.join('; ')}`;
}
