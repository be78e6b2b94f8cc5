/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {colour, element, fixed} from './numbers.js';

const LONGEST = 5;     // of the error shown [s]
const SETTLING = 0.5;  // after a switch, not counted [s]

/* Three digits at most, and no exponent. */
const large = (value) => fixed(value, value < 9.995 ? 2 : value < 99.95 ? 1 : 0);

/* The friction compensation: off, on or one of a few others, and the error it leaves. */
export class Compensation {
  constructor(parameter, panel, card, session) {
    Object.assign(this, parameter);
    this.first = parameter.value;
    this.panel = panel;
    this.since = NaN;
    this.kept = new Map();   // compensation: error of each joint while it was on
    this.root = card;
    this.other = 'gms';      // what the switch goes to from none
    this.switch = ['none', this.other].map((mode) => {
      const made = element('button', {type: 'button', 'aria-pressed': 'false'}, mode);
      made.addEventListener('click', () => panel.send(this, made.textContent));
      return made;
    });
    this.select = element('select', {id: 'compensation-choice', 'aria-label': this.name},
      ...this.choices.map((one) => element('option', {value: one}, one)));
    this.select.addEventListener('change', () => panel.send(this, this.select.value));
    this.answer = element('p', {class: 'answer', role: 'status'});
    this.cells = session.scene.joints.map(() => [element('output', {class: 'large'}, '–'),
                                                 element('small')]);
    card.dataset.name = this.name;
    card.replaceChildren(
      element('header', {}, element('h2', {}, 'Friction compensation'), this.select),
      element('div', {class: 'switch', role: 'group', 'aria-label': 'Compensation'},
        ...this.switch), this.answer,
      element('div', {class: 'errors'}, ...session.scene.joints.map((name, j) => element(
        'div', {}, element('span', {}, element('span', {
          class: 'dot', style: `background: var(${colour(j)})`}), name), element('span', {
          class: 'now'}, this.cells[j][0], ` ${session.scene.units.mrad}`), this.cells[j][1]))),
      element('p', {class: 'legend'}, `Tracking error, rms since the switch, of at most ${LONGEST} s`));
    card.hidden = false;
    this.hold(this.first);
  }

  hold(value) {
    if (value !== this.value) this.begin();
    this.value = this.select.value = value;
    if (value !== 'none') this.other = value;
    this.switch[1].textContent = this.other;
    for (const button of this.switch)
      button.setAttribute('aria-pressed', button.textContent === value);
    this.root.classList.toggle('changed', value !== this.first);
    this.panel.changed();
  }

  say(accepted, text) {
    this.root.classList.toggle('refused', !accepted);
    this.answer.textContent = accepted ? '' : text;
  }

  /* Count errors anew: another compensation is on, or no torque flows. */
  begin() {
    this.since = NaN;
    for (const [now] of this.cells) now.textContent = '–';
  }

  /* Show the error that a source of rows has had of late. */
  show(source) {
    if (!(this.since <= source.end + SETTLING)) this.since = source.end + SETTLING;
    const begin = Math.max(this.since, source.end - LONGEST);
    const errors = this.cells.map((_, j) => source.rms(`error.${j}`, begin));
    if (errors.some(Number.isFinite)) {
      this.kept.delete(this.value);  // the last of the map is the one of now
      this.kept.set(this.value, errors);
    }
    const [mode, before] = [...this.kept].filter(([one]) => one !== this.value).pop() || [];
    this.cells.forEach(([now, then], j) => {
      now.textContent = large(1e3 * errors[j]);
      then.textContent = mode ? `${mode}: ${large(1e3 * before[j])}` : '';
    });
  }
}
