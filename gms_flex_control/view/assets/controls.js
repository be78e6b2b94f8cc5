/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {element, fixed} from './numbers.js';
import {send} from './sources.js';

const NOTABLE = 0.1;   // share of late samples, as of the plant's own warning
const SHOWN = 4000;     // an answer [ms]
const GROUPS = [
  ['Motion', [['start', 'Start'], ['stop', 'Stop']]],
  ['Torque', [['enable', 'On'], ['disable', 'Off'], ['reset', 'Reset']]]];
const TOLD = new Set(['start', 'stop']);   // of others the state tells what came of it
const NEXT = {FAULT: 'reset', ZERO: 'enable'};   // the way on from a state

/* How the robot is, and the requests that plant and trajectory answer. */
export class Controls {
  constructor(place, session) {
    this.state = element('strong', {id: 'robot-state'}, '–');
    this.reason = element('span', {id: 'robot-reason'});
    this.rate = element('output', {id: 'robot-rate'}, '–');
    this.late = element('output', {id: 'robot-late'}, '–');
    this.answer = element('span', {class: 'answer', role: 'status'});
    this.buttons = new Map();
    const groups = GROUPS.map(([name, requests]) => element('div', {
      class: 'requests', role: 'group', 'aria-label': name}, element('span', {}, name),
    ...requests.map(([request, label]) => this.button(request, label, `${name}: ${label}`))));
    this.place = place;
    place.replaceChildren(
      element('div', {class: 'said', role: 'status'}, this.state, this.reason, this.answer),
      element('div', {class: 'pace', title: 'samples of the last 3 s; late: without a command in '
        + 'time, or left out'}, this.rate, this.late), ...groups,
      this.button('emergency_stop', 'Emergency stop', 'Emergency stop'));
    place.hidden = false;
  }

  button(request, label, name) {
    const made = element('button', {type: 'button', id: `ask-${request}`, 'aria-label': name},
      label);
    made.addEventListener('click', () => this.ask(request));
    this.buttons.set(request, made);
    return made;
  }

  async ask(request) {
    try {
      const {success, message} = await send('/api/call', {name: request});
      this.say(success, success && !TOLD.has(request) ? '' : message);
    } catch (error) {
      this.say(false, error.message);
    }
  }

  /* Show an answer: for a while, or where it is a refusal, until the next. */
  say(success, text) {
    clearTimeout(this.timer);
    this.answer.classList.toggle('refused', !success);
    this.answer.textContent = text;
    if (success) this.timer = setTimeout(() => this.say(true, ''), SHOWN);
  }

  /* Whether torque flows, as far as is known. */
  get torque() { return !NEXT[this.state.textContent]; }

  /* What the server says of the robot, null where it is not known, and of the controller. */
  show(robot, complaint) {
    const all = JSON.stringify([robot, complaint]);
    if (all === this.all) return;
    this.all = all;
    const state = robot ? robot.state : 'unknown';
    const reason = robot ? robot.reason : 'no plant_node reports on /diagnostics';
    this.place.dataset.state = this.state.textContent = state;
    this.reason.textContent = complaint ? `${reason}; controller: ${complaint}` : reason;
    this.rate.textContent = `${robot ? fixed(robot.rate, 0) : '–'} Hz`;
    this.late.textContent = `${robot && robot.late != null ? fixed(100 * robot.late, 2) : '–'} % late`;
    this.late.classList.toggle('notable', Boolean(robot) && robot.late > NOTABLE);
    for (const [request, button] of this.buttons)
      button.classList.toggle('next', NEXT[state] === request);
  }
}
