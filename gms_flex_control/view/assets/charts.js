/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
/* global uPlot */
import {clamp, colour, css, element, fixed} from './numbers.js';

export const GUTTER = 58;   // left of every plot, so that all share one time axis [px]
export const MARGIN = 14;   // right of it
const NARROWEST = 1e-3;     // window [s]

const PLOTS = [
  {id: 'error', title: 'Tracking error', unit: 'mrad', factor: 1e3, places: 2,
   lines: [{signal: 'error', label: 'link − reference'}],
   missing: 'tracking error: there is no reference'},
  {id: 'torque', title: 'Torque', unit: 'N m', factor: 1, places: 3,
   lines: [{signal: 'command', label: 'command'},
           {signal: 'friction', label: 'friction estimate', dashed: true}],
   missing: 'torque: there are no commands'},
  {id: 'angle', title: 'Angle', unit: 'rad', factor: 1, places: 3,
   lines: [{signal: 'link', label: 'link'},
           {signal: 'reference', label: 'reference', dashed: true}], missing: ''},
  {id: 'torsion', title: 'Spring deflection', unit: 'mrad', factor: 1e3, places: 1,
   lines: [{signal: 'torsion', label: 'motor − link'}],
   missing: 'spring deflection: there is no motor side'},
];

function tickLabels(u, ticks, axis, space, step) {
  let places = 0;
  while (places < 6 && Math.abs(step * 10 ** places - Math.round(step * 10 ** places)) > 1e-6)
    places++;
  return ticks.map((v) => (v == null ? '' : v === 0 ? '0'
    : places > 4 || Math.abs(v) >= 1e5 ? v.toExponential(0) : v.toFixed(places))
    .replace('-', '−'));
}

/* One plot: a heading with the values of the moment, the lines, and where the moment is. */
class Plot {
  constructor(spec, session, group) {
    this.spec = spec;
    this.group = group;
    const unit = session.scene.units[spec.unit];
    const bags = ['', ...Array.from({length: session.over || 0}, (_, k) => `@${k + 1}`)];
    this.lines = spec.lines.flatMap((line) => session.scene.joints.flatMap((name, j) => bags.map(
      (bag) => ({...line, joint: j, column: `${line.signal}.${j}${bag}`, name, pale: bag !== ''}))))
      .filter((line) => group.source.has(line.signal)
        && !(line.signal === 'torsion' && session.scene.rigid[line.joint]));
    this.values = element('div', {class: 'values'});
    this.box = element('div', {class: 'plot'});
    this.root = element('section', {class: 'chart', id: `plot-${spec.id}`,
                                    'aria-label': `${spec.title} in ${unit} over time`},
      element('header', {}, element('h2', {}, spec.title, ' ', element('small', {},
        `[${unit}]`)), this.values), this.box);
    this.cells = new Map();
    for (const line of spec.lines) {
      const mine = this.lines.filter((one) => one.signal === line.signal && !one.pale);
      if (!mine.length) continue;
      const numbers = mine.map((one) => {
        const cell = element('output', {style: `--joint: var(${colour(one.joint)})`}, '–');
        this.cells.set(one.column, cell);
        return cell;
      });
      this.values.append(element('span', {class: 'value'}, element('i', {
        class: line.dashed ? 'dash' : 'solid'}), line.label, ...numbers));
    }
    this.playhead = element('div', {class: 'playhead'});
  }

  draw() {
    if (this.plot) this.plot.destroy();
    const axis = {
      stroke: css('--muted'), grid: {stroke: css('--grid'), width: 1},
      ticks: {stroke: css('--grid'), width: 1, size: 4}, font: '11px system-ui, sans-serif', gap: 3,
      values: tickLabels};
    const {factor} = this.spec;
    this.plot = new uPlot({
      width: this.box.clientWidth, height: this.box.clientHeight, padding: [8, MARGIN, 0, 0],
      scales: {x: {time: false}, y: {range: (u, low, high) => {
        if (low == null) return [-1, 1];
        const room = high > low ? 0.08 * (high - low) : Math.abs(high) * 0.1 || 1e-3 * factor;
        return [low - room, high + room];
      }}},
      axes: [{...axis, size: 22}, {...axis, size: GUTTER, space: 20}],
      legend: {show: false},
      cursor: {y: false, drag: {x: false, y: false}, points: {size: 5}, sync: {
        key: 'time', scales: ['x', null]}},
      series: [{}, ...this.lines.map((line) => ({
        stroke: css(colour(line.joint)), width: line.dashed ? 1.3 : 1.6,
        dash: line.dashed ? [5, 4] : undefined, points: {show: false}, alpha: line.pale ? 0.4 : 1,
        show: this.group.shown[line.joint]}))],
    }, [[0, 1], ...this.lines.map(() => [null, null])], this.box);
    this.plot.over.append(this.playhead);
    this.group.listen(this.plot.over, (x) => this.plot.posToVal(x, 'x'));
    this.plot.over.setAttribute('role', 'img');
    this.plot.over.setAttribute('aria-label', `${this.spec.title}, ${this.lines.length} lines`);
  }

  set(table) {
    const {factor} = this.spec;
    this.plot.setData([table.x, ...this.lines.map((line) => Array.from(
      table.column(line.column), (v) => (Number.isFinite(v) ? v * factor : null)))], false);
    this.window();
  }

  window() { this.plot.setScale('x', {min: this.group.min, max: this.group.max}); }

  point(frame) {
    const {factor, places} = this.spec;
    for (const [column, cell] of this.cells) {
      const joint = Number(column.split('.')[1]);
      cell.hidden = !this.group.shown[joint];
      cell.textContent = fixed(frame(column) * factor, places);
    }
  }
}

/* All plots over one window of time. */
export class Plots {
  constructor(place, chips, session, source, seek) {
    this.place = place;
    this.session = session;
    this.source = source;
    this.seek = seek;
    this.moved = () => {};    // the window was changed by hand
    this.drawn = () => {};    // new data came
    this.shown = session.scene.joints.map(() => true);
    this.min = source.begin;
    this.max = Math.max(source.end, source.begin + NARROWEST);
    this.asked = this.answered = 0;
    this.members = PLOTS.map((spec) => new Plot(spec, session, this))
      .filter((plot) => plot.lines.length);
    this.missing = PLOTS.filter((spec) => spec.missing && !this.members.some(
      (plot) => plot.spec === spec)).map((spec) => spec.missing);
    place.replaceChildren(...this.members.map((plot) => plot.root));
    this.members.forEach((plot) => plot.draw());
    this.choose(chips);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(place);
    this.redraw = () => { this.members.forEach((plot) => plot.draw()); this.refresh(); };
    this.dark = matchMedia('(prefers-color-scheme: dark)');
    this.dark.addEventListener('change', this.redraw);
  }

  destroy() {
    this.observer.disconnect();
    this.dark.removeEventListener('change', this.redraw);
    this.members.forEach((plot) => plot.plot.destroy());
  }

  choose(chips) {
    const names = this.session.scene.joints;
    chips.hidden = names.length < 2;
    chips.replaceChildren(...names.map((name, j) => {
      const button = element('button', {type: 'button', class: 'chip', 'aria-pressed': 'true',
                                        style: `--joint: var(${colour(j)})`}, name);
      button.addEventListener('click', () => {
        this.shown[j] = !this.shown[j];
        button.setAttribute('aria-pressed', this.shown[j]);
        for (const plot of this.members)
          plot.lines.forEach((line, k) => {
            if (line.joint === j) plot.plot.setSeries(k + 1, {show: this.shown[j]});
          });
        if (this.last) this.point(...this.last);
      });
      return button;
    }));
  }

  resize() {
    for (const plot of this.members)
      plot.plot.setSize({width: plot.box.clientWidth, height: plot.box.clientHeight});
    this.refresh();
  }

  get width() {
    return this.members.length ? this.members[0].plot.over.clientWidth || 300 : 300;
  }

  /* Fetch what the window needs, one request at a time. */
  async refresh() {
    this.asked++;
    if (this.busy) return;
    this.busy = true;
    try {
      while (this.answered !== this.asked) {
        this.answered = this.asked;
        const table = await this.source.plots(this.min, this.max, 2 * this.width);
        if (table.x.length) {
          for (const plot of this.members) plot.set(table);
          this.drawn(table);
        }
      }
    } catch (error) {
      this.source.failed(error);
    } finally {
      this.busy = false;
    }
  }

  show(min, max, byHand = true) {
    const {begin, end} = this.source;
    const whole = Math.max(end - begin, NARROWEST);
    const width = clamp(max - min, NARROWEST, whole);
    this.min = clamp(min, begin, begin + whole - width);
    this.max = this.min + width;
    this.place.dataset.width = width.toFixed(3);
    if (byHand) this.moved();
    for (const plot of this.members) plot.window();
    if (this.last) this.point(...this.last);
    this.refresh();
  }

  reset() { this.show(-Infinity, Infinity); }

  zoom(centre, factor) {
    this.show(centre - (centre - this.min) * factor, centre + (this.max - centre) * factor);
  }

  /* A moment: the line in every plot, and the values there. */
  point(frame, time) {
    this.last = [frame, time];
    const share = (time - this.min) / (this.max - this.min);
    for (const plot of this.members) {
      plot.playhead.style.display = share >= 0 && share <= 1 ? '' : 'none';
      plot.playhead.style.left = `${100 * share}%`;
      plot.point(frame);
    }
  }

  /* Drag moves the window, a click goes to that time, wheel and shift-drag zoom. */
  listen(over, toTime) {
    let start = null, armed = false;
    const at = (e) => clamp(e.clientX - over.getBoundingClientRect().left, 0, over.clientWidth);
    over.tabIndex = -1;
    const band = element('div', {class: 'band', hidden: true});
    over.append(band);
    over.addEventListener('pointerdown', (e) => {
      if (e.button) return;
      over.setPointerCapture(e.pointerId);
      start = {x: at(e), min: this.min, max: this.max, box: e.shiftKey, far: false};
    });
    over.addEventListener('pointermove', (e) => {
      armed = armed || Boolean(e.movementX || e.movementY);
      if (!start) return;
      const x = at(e), perPixel = (start.max - start.min) / over.clientWidth;
      start.far = start.far || Math.abs(x - start.x) > 4;
      if (start.box) {
        band.hidden = false;
        band.style.left = `${Math.min(x, start.x)}px`;
        band.style.width = `${Math.abs(x - start.x)}px`;
      } else if (start.far)
        this.show(start.min - (x - start.x) * perPixel, start.max - (x - start.x) * perPixel);
    });
    over.addEventListener('pointerup', (e) => {
      if (!start) return;
      const x = at(e);
      if (!start.far) this.seek(toTime(x));
      else if (start.box) this.show(toTime(Math.min(x, start.x)), toTime(Math.max(x, start.x)));
      start = null;
      band.hidden = true;
    });
    over.addEventListener('pointercancel', () => { start = null; band.hidden = true; });
    over.addEventListener('dblclick', () => this.reset());
    /* the wheel keeps scrolling the page until the pointer was moved over the plot */
    over.addEventListener('wheel', (e) => {
      if (!armed && !e.ctrlKey) return;
      e.preventDefault();
      const turn = (e.deltaY || e.deltaX) * (e.deltaMode === 1 ? 20 : 1);
      this.zoom(toTime(at(e)), Math.exp(clamp(turn * 0.002, -1, 1)));
    }, {passive: false});
    over.addEventListener('pointerleave', () => { armed = false; });
  }
}

