/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {colour, css, element, fixed} from './numbers.js';
import {GUTTER, MARGIN} from './charts.js';

const LANE = 9;      // height of one block in the strip [px]
const BETWEEN = 8;   // joints [px]

const origins = {observer: 'as the observer has them',
                 model: 'of the model, along the recorded motion'};

function legend() {
  return element('p', {class: 'legend'}, ...[['sticks', 'sticks, a spring'], ['slips', 'slips']].map(
    ([name, text]) => element('span', {class: 'entry'}, element('span', {class: `key ${name}`}),
      text)));
}

/* The blocks at the moment: how far each is loaded, and whether it slips. */
export class BlockBars {
  constructor(card, session) {
    const {count, origin} = session.blocks, {joints, limits} = session.scene;
    this.limits = limits;
    this.largest = session.load || 1e-6;
    this.cells = joints.map(() => []);
    const rows = joints.map((name, j) => {
      const row = element('div', {class: 'lanes', role: 'img', 'aria-label': name});
      for (let i = 0; i < count; i++) {
        const fill = element('i');
        const cell = element('span', {class: 'cell', title: `${name}, block ${i + 1}`}, fill);
        row.append(cell);
        this.cells[j].push({cell, fill});
      }
      return [element('span', {class: 'name'}, element('span', {
        class: 'dot', style: `background: var(${colour(j)})`}), name), row];
    });
    this.rows = rows.map(([, row]) => row);
    card.replaceChildren(element('header', {}, element('h2', {}, 'Friction blocks ', element(
      'small', {}, origins[origin] || ''))), legend(), element('div', {class: 'bars'},
      ...rows.flat()));
    card.hidden = !count;
    this.names = joints;
  }

  show(frame) {
    this.cells.forEach((cells, j) => {
      let slipping = 0;
      cells.forEach(({cell, fill}, i) => {
        const torque = frame(`block.${j}.${i}`), stick = frame(`stick.${j}.${i}`);
        const limit = this.limits.length ? this.limits[j][i] : 0;
        if (!limit && Math.abs(torque) > this.largest) this.largest = Math.abs(torque);
        const share = Math.max(-1, Math.min(1, torque / (limit || this.largest))) || 0;
        fill.style.height = `${50 * Math.abs(share)}%`;
        fill.style.top = share >= 0 ? `${50 - 50 * share}%` : '50%';
        cell.classList.toggle('slips', stick === 0);
        cell.classList.toggle('unknown', !Number.isFinite(stick));
        slipping += stick === 0;
      });
      const text = `${this.names[j]}: ${slipping} of ${cells.length} blocks slip`;
      if (this.rows[j].getAttribute('aria-label') !== text)
        this.rows[j].setAttribute('aria-label', text);
    });
  }
}

/* Stick and slip of every block over time: a thin line sticks, a full bar slips. */
export class BlockStrip {
  constructor(place, session, plots) {
    const {joints} = session.scene, {count} = session.blocks;
    this.session = session;
    this.plots = plots;
    this.height = joints.length * (count * LANE + BETWEEN);
    this.canvas = element('canvas', {role: 'img', 'aria-label': 'Stick and slip of each block'});
    this.over = element('div', {class: 'u-over'}, this.playhead = element('div', {
      class: 'playhead'}));
    const labels = element('div', {class: 'names', style: `width: ${GUTTER}px`},
      ...joints.map((name) => element('span', {style: `height: ${count * LANE + BETWEEN}px`}, name)));
    this.frame = element('div', {class: 'strip', style:
      `height: ${this.height}px; margin-right: ${MARGIN}px`}, labels,
    element('div', {class: 'area'}, this.canvas, this.over));
    this.root = element('section', {class: 'chart', id: 'plot-blocks',
                                    'aria-label': 'Stick and slip over time'},
      element('header', {}, element('h2', {}, 'Stick and slip of each block'), legend()), this.frame);
    place.append(this.root);
    plots.listen(this.over, (x) => plots.min + (plots.max - plots.min) * x
      / this.over.clientWidth);
  }

  draw(table) {
    this.table = table;
    const {joints} = this.session.scene, {count} = this.session.blocks;
    const width = this.over.clientWidth, ratio = devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    const pen = this.canvas.getContext('2d');
    pen.scale(ratio, ratio);
    const {min, max} = this.plots, sticks = css('--sticks'), slips = css('--slips');
    const last = table.x.length - 1, words = [];
    const x = Float64Array.from(table.x, (t) => Math.round(  // whole pixels stay crisp
      (t - min) / (max - min) * width * ratio) / ratio);
    joints.forEach((name, j) => {
      let sum = 0, known = 0;
      for (let i = 0; i < count; i++) {
        const values = table.column(`stick.${j}.${i}`);
        const top = j * (count * LANE + BETWEEN) + i * LANE;
        for (let k = 0, next; k <= last; k = next) {
          next = k + 1;
          if (!Number.isFinite(values[k])) continue;
          while (next <= last && values[next] === values[k]) next++;  // one segment of the same
          sum += values[k] * (next - k);
          known += next - k;
          const from = Math.max(x[k], 0);
          const to = Math.min(Math.max(x[Math.min(next, last)], x[k] + 1 / ratio), width);
          if (to <= from) continue;
          pen.globalAlpha = values[k] ? 0.9 : 0;
          pen.fillStyle = sticks;
          pen.fillRect(from, top + LANE / 2 - 1, to - from, 1.6);
          pen.globalAlpha = 1 - values[k];
          pen.fillStyle = slips;
          pen.fillRect(from, top + 1, to - from, LANE - 2);
        }
      }
      if (known) words.push(`${name} sticks ${fixed(100 * sum / known, 0)} %`);
    });
    this.canvas.setAttribute('aria-label', `Blocks of ${words.join(', ')} of the time shown`);
  }

  point(time) {
    const share = (time - this.plots.min) / (this.plots.max - this.plots.min);
    this.playhead.style.display = share >= 0 && share <= 1 ? '' : 'none';
    this.playhead.style.left = `${100 * share}%`;
  }
}
