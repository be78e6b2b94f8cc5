/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {Arm, JointTable, sentence} from './arm.js';
import {BlockBars, BlockStrip} from './blocks.js';
import {Plots} from './charts.js';
import {Controls} from './controls.js';
import {Gains} from './gains.js';
import {calm, element} from './numbers.js';
import {SpaceArm} from './space.js';
import {ask, BagSource, LiveSource} from './sources.js';
import {Transport} from './transport.js';

/* what is drawn takes the processor from the loop that is watched */
const LIVE = 66;         // between frames of the running loop's arm [ms]
const REDRAW = 250;      // of its numbers and plots [ms]
const CALM = 300;        // of everything, for those who asked for less motion [ms]
const RETRY = 1000;      // [ms]
const at = (id) => document.getElementById(id);
let shown = null;        // the view on the page

/* One session on the page: a bag, or the running loop with one set of columns. */
class View {
  constructor(session) {
    this.session = session;
    this.live = session.mode === 'live';
    this.source = this.live ? new LiveSource(session) : new BagSource(session);
    this.source.failed = (error) => this.report(error.message);
    this.source.said = (text) => this.report(text);
    this.source.outdated = begin;
    this.source.arrived = () => { if (!this.transport.playing) this.show(true); };
    at('title').textContent = session.title;
    document.title = `${session.title} · gms_flex view`;
    at('badge').hidden = !this.live;
    at('badge').textContent = 'live';
    at('notes').replaceChildren(...session.notes.map((text) => element('p', {class: 'note'}, text)));
    this.transport = new Transport(at('transport'), session, this.source);
    this.transport.changed = () => this.paced();
    this.transport.sought = () => this.show(true);
    this.transport.zoomed = (factor) => this.zoom(factor);
    this.arm = new (session.scene.frames ? SpaceArm : Arm)(at('arm'), at('keys-arm'), session,
      (signal) => this.live || this.source.has(signal));
    this.build();
    if (this.live) {
      this.controls = new Controls(at('robot'), session);
      this.source.reported = (robot, complaint) => this.controls.show(robot, complaint);
      this.gains = new Gains(at('gains'), at('compensation'), session);
    }
    at('middle').hidden = !this.live;
    this.before = performance.now();
    this.drawn = this.frames = 0;
    this.paced();
    this.next();
  }

  report(text) { if (at('state').textContent !== text) at('state').textContent = text; }

  /* Everything that depends on which signals there are. */
  build() {
    const has = (signal) => this.source.has(signal);
    this.built = ['link', 'motor', 'reference', 'command', 'friction', 'block', 'stick'].map(has).join();
    if (this.plots) this.plots.destroy();
    this.plots = new Plots(at('plots'), at('chips'), this.session, this.source,
      (time) => this.transport.seek(time));
    this.plots.moved = () => { this.byHand = true; if (this.live) this.transport.pause(); };
    this.table = new JointTable(at('joints'), this.session, has);
    const missing = this.plots.missing.slice();
    this.bars = this.strip = null;
    at('blocks').hidden = true;
    if (has('stick') || has('block')) this.bars = new BlockBars(at('blocks'), this.session);
    else missing.push(this.live ? 'friction blocks: the controller publishes none'
      : 'friction blocks: neither in the bag nor computed, which takes a robot file');
    if (has('stick')) {
      this.strip = new BlockStrip(at('plots'), this.session, this.plots);
      this.plots.drawn = (table) => this.strip.draw(table);
    } else if (this.bars) missing.push('stick and slip: it was not recorded');
    at('missing').replaceChildren(...missing.map((text) => element('li', {}, `No ${text}.`)));
    this.plots.refresh();
  }

  paced() {
    const {transport} = this;
    this.source.setPace(transport.playing ? transport.speed / 60 : 0);
    if (transport.playing) this.byHand = false;
    else this.show(true);
  }

  zoom(factor) {
    if (factor === Infinity) this.plots.reset();
    else this.plots.zoom(this.transport.time, factor);
  }

  /* Draw the moment, the `whole` of it or the arm; a `settled` one is also spoken. */
  show(settled = false, whole = true) {
    const {transport, source, plots} = this, {time} = transport;
    const frame = source.frame(time);
    if (frame) {
      if (this.live) this.arm.makeRoom(frame);
      this.arm.show(frame, time, (past) => (past >= source.begin ? source.frame(past) : null));
    }
    if (!whole) return;
    transport.show();
    if (frame) {
      this.table.show(frame);
      if (this.bars) this.bars.show(frame);
      plots.point(frame, time);
      if (this.strip) this.strip.point(time);
      document.documentElement.dataset.time = time.toFixed(4);
    }
    if (settled && frame)
      at('spoken').textContent = transport.playing ? '' : sentence(this.session, frame, time);
  }

  /* The window goes along with the time. */
  follow(now) {
    const {plots, transport, source} = this;
    if (this.live) {
      if (!transport.playing || now - this.drawn < REDRAW) return;
      this.drawn = now;
      plots.show(Math.max(source.begin, source.end - transport.window), source.end, false);
      this.gains.show(source, this.controls.torque);
      if (['link', 'motor', 'reference', 'command', 'friction', 'block', 'stick'].map(
        (signal) => source.has(signal)).join() !== this.built) this.build();
    } else if (transport.playing && (transport.time > plots.max || transport.time < plots.min)) {
      const width = plots.max - plots.min;
      plots.show(transport.time, transport.time + width, false);
    }
  }

  /* Draw again as soon as it is due. */
  next() {
    const draw = () => requestAnimationFrame((now) => this.tick(now));
    const pause = calm.matches ? CALM : this.live ? LIVE : 0;
    if (pause) setTimeout(draw, pause);
    else draw();
  }

  tick(now) {
    if (this.over) return;
    this.next();
    if (calm.matches !== this.calm) {
      this.calm = calm.matches;
      this.show();
    }
    const seconds = Math.min((now - this.before) / 1000, 0.5);
    this.before = now;
    if (this.transport.advance(seconds)) {
      this.follow(now);
      this.show(false, !this.live || this.drawn === now);
      document.documentElement.dataset.frames = ++this.frames;
    }
  }

  close() {
    this.over = true;
    this.transport.destroy();
    this.plots.destroy();
    if (this.gains) this.gains.destroy();
    if (this.live) this.source.close();
  }
}

async function begin() {
  try {
    const session = await (await ask('/api/session')).json();
    if (shown) shown.close();
    shown = null;
    if (!session.scene) {
      wait();
      return;
    }
    shown = new View(session);
    const wanted = Number(new URLSearchParams(location.hash.slice(1)).get('t'));
    if (wanted && !shown.live) shown.transport.seek(wanted);
    document.documentElement.dataset.ready = session.mode;
  } catch (error) {
    at('state').textContent = error.message;
    setTimeout(begin, RETRY);
  }
}

/* Nothing is known yet: listen until something is. */
function wait() {
  const events = new EventSource('/api/live');
  events.onmessage = (event) => {
    const {state, version} = JSON.parse(event.data);
    at('state').textContent = state;
    if (!version) return;
    events.close();
    begin();
  };
  events.onerror = () => { events.close(); setTimeout(begin, RETRY); };
}

begin();
