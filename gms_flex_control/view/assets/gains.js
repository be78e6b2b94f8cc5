/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {Compensation} from './compensation.js';
import {clamp, element, format} from './numbers.js';
import {ask, send} from './sources.js';

const STEPS = 400;      // of a slider
const SPAN = 10;        // a slider reaches this many times the value, up and down
const LOOK = 3000;      // others may set gains as well [ms]

const plain = (value) => String(Number(value.toPrecision(4)));

/* One gain: slider, number, and what the controller says to it. */
class Gain {
  constructor(parameter, panel) {
    Object.assign(this, parameter);
    this.panel = panel;
    this.first = parameter.value;
    const short = this.name.split('.').pop();
    const id = `gain-${this.name.replaceAll('.', '-')}`;
    const [, text, unit] = /^(.*?)(?: \[(.*)\])?$/.exec(this.description) || [];
    this.number = element('input', {type: 'number', step: 'any', id, value: plain(this.first),
                                    'aria-describedby': `${id}-answer`});
    this.slider = element('input', {type: 'range', min: '0', max: String(STEPS), 'aria-label':
      `${short}, slider`});
    this.answer = element('p', {class: 'answer', id: `${id}-answer`, role: 'status'});
    this.root = element('div', {class: 'gain', 'data-name': this.name},
      element('label', {for: id, title: text || ''}, short, unit ? element('small', {}, ` ${unit}`)
        : ''), this.slider, this.number, this.answer);
    this.slider.addEventListener('input', () => { this.number.value = plain(this.atSlider()); });
    this.slider.addEventListener('change', () => this.set(Number(plain(this.atSlider()))));
    this.number.addEventListener('change', () => this.set(this.number.valueAsNumber));
    this.number.disabled = this.slider.disabled = this.read_only;
    this.hold(this.first);
  }

  /* Let the slider reach from below a value to above it; what is too much the node refuses. */
  reach(value) {
    this.low = Math.max(this.lower ?? -Infinity, value > 0 ? value / SPAN : 0);
    this.high = value > 0 ? value * SPAN : 1;
  }

  atSlider() {
    const share = Number(this.slider.value) / STEPS;
    return this.low > 0 ? this.low * (this.high / this.low) ** share
      : this.low + (this.high - this.low) * share;
  }

  /* Show what holds. */
  hold(value) {
    if (value === this.first || value < this.low || value > this.high) this.reach(value);
    this.value = value;
    this.number.value = plain(value);
    const share = this.low > 0 ? Math.log(Math.max(value, 1e-300) / this.low)
      / Math.log(this.high / this.low) : (value - this.low) / (this.high - this.low);
    this.slider.value = String(Math.round(STEPS * clamp(share, 0, 1)));
    this.slider.setAttribute('aria-valuetext', plain(value));
    this.root.classList.toggle('changed', value !== this.first);
    this.panel.changed();
  }

  async set(value) {
    if (!Number.isFinite(value)) {
      this.say(false, 'not a number');
      this.hold(this.value);
      return;
    }
    await this.panel.send(this, value);
  }

  say(accepted, text) {
    this.root.classList.toggle('refused', !accepted);
    this.answer.textContent = text;
  }
}

/* Gains of the running controller, set through ROS. */
export class Gains {
  constructor(card, compensation, session) {
    this.card = card;
    this.place = compensation;
    this.session = session;
    this.controller = session.controller;
    this.items = [];
    this.status = element('p', {class: 'legend', role: 'status'});
    this.body = element('div');
    this.back = element('button', {type: 'button', hidden: true}, 'Back to the first values');
    this.back.addEventListener('click', () => this.restore());
    card.replaceChildren(element('header', {}, element('h2', {}, 'Gains ', element('small', {},
      this.controller)), this.back), this.status, this.body);
    card.hidden = false;
    this.load();
    this.timer = setInterval(() => this.look(), LOOK);
  }

  destroy() { clearInterval(this.timer); }

  changed() { this.back.hidden = !this.items.some((item) => item.value !== item.first); }

  async load() {
    try {
      const found = await (await ask('/api/parameters')).json();
      this.status.textContent = 'Set as soon as you let go; the controller refuses what it '
        + 'cannot use.';
      this.build(found);
    } catch (error) {
      this.status.textContent = error.message;
    }
  }

  build(found) {
    const groups = new Map();
    this.items = [];
    for (const one of found)
      if (one.choices.length)
        this.items.push(this.compensation = new Compensation(one, this, this.place, this.session));
      else if (typeof one.value === 'number') {
        const item = new Gain(one, this), group = item.name.split('.').slice(1, -1).join('.');
        this.items.push(item);
        groups.set(group, [...(groups.get(group) || []), item.root]);
      }
    this.body.replaceChildren(...[...groups].sort(([a], [b]) => (a > b) - (a < b)).map(
      ([name, roots], k) => element('details', {open: k < 2}, element('summary', {}, name),
        ...roots)));
  }

  /* Show the error that the present compensation leaves; none without torque. */
  show(source, torque) {
    if (!this.compensation) return;
    if (torque) this.compensation.show(source);
    else this.compensation.begin();
  }

  /* Another tool may have set something, or the controller may have come or gone. */
  async look() {
    if (document.hidden || this.sending) return;
    if (!this.items.length) { this.load(); return; }
    if (this.card.contains(document.activeElement) && document.activeElement.matches('input')) return;
    try {
      const found = await (await ask('/api/parameters')).json();
      for (const one of found) {
        const item = this.items.find(({name}) => name === one.name);
        if (item && item.value !== one.value) item.hold(one.value);
      }
    } catch (error) {
      this.status.textContent = error.message;
    }
  }

  async send(item, value) {
    this.sending = true;
    item.root.classList.add('pending');
    try {
      const answer = await send('/api/parameters', {name: item.name, value});
      item.say(answer.accepted, answer.accepted ? `set to ${
        typeof answer.value === 'number' ? format(answer.value) : answer.value}`
        : `refused: ${answer.reason}`);
      item.hold(answer.value ?? item.value);
    } catch (error) {
      item.say(false, error.message);
      item.hold(item.value);
    } finally {
      this.sending = false;
      item.root.classList.remove('pending');
    }
  }

  async restore() {
    for (const item of this.items) if (item.value !== item.first) await this.send(item, item.first);
  }
}
