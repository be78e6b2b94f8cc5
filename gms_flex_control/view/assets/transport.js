/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {clamp, clock, element} from './numbers.js';

const SPEEDS = [0.01, 0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10, 50];
const WINDOWS = [2, 5, 10, 30, 60];
const ICONS = {play: 'M6 4l14 8-14 8z', pause: 'M6 4h4v16H6zM14 4h4v16h-4z',
               back: 'M6 5h3v14H6zM20 5v14L10 12z', forth: 'M15 5h3v14h-3zM4 5v14l10-7z'};
const KEYS = [['space', 'play or pause'], ['← →', 'one sample'], ['shift ← →', 'one second'],
              ['home end', 'to begin or end'], ['[ ]', 'slower, faster'], ['+ −', 'zoom the plots'],
              ['0', 'all of it'], ['l', 'play again and again']];

const icon = (name) => `<svg viewBox="0 0 24 24" aria-hidden="true"><path d="${ICONS[name]}"/></svg>`;

/* Play, pause, step, scrub and speed. It knows the time; others draw it. */
export class Transport {
  constructor(place, session, source) {
    this.live = session.mode === 'live';
    this.source = source;
    this.time = source.begin;
    this.playing = this.live;  // live: follow what comes in
    this.speed = 1;
    this.window = 10;
    this.loop = false;
    this.changed = () => {};   // playing or speed
    this.sought = () => {};    // the time, by hand
    this.zoomed = () => {};    // + - 0
    this.build(place);
    this.listener = (e) => this.key(e);
    document.addEventListener('keydown', this.listener);
  }

  destroy() { document.removeEventListener('keydown', this.listener); }

  build(place) {
    const button = (id, label, name, act) => {
      const made = element('button', {type: 'button', id, 'aria-label': label, title: label});
      made.innerHTML = icon(name);
      made.addEventListener('click', act);
      return made;
    };
    this.playButton = button('play', 'Play', 'play', () => this.toggle());
    const back = button('back', 'One sample back', 'back', () => this.step(-1));
    const forth = button('forth', 'One sample on', 'forth', () => this.step(1));
    this.slider = element('input', {type: 'range', id: 'scrub', min: '0', max: '1', step: 'any',
                                    value: '0', 'aria-label': 'Time'});
    this.slider.addEventListener('input', () => this.seek(this.fromSlider()));
    this.shownTime = element('output', {id: 'time', 'for': 'scrub'});
    this.choice = this.live
      ? this.options('window', 'Window', WINDOWS, this.window, (one) => `${one} s`)
      : this.options('speed', 'Speed', SPEEDS, this.speed, (one) => `${one} ×`);
    this.again = element('button', {type: 'button', id: 'loop', 'aria-pressed': 'false',
                                    title: 'Play again and again'}, 'Loop');
    this.again.addEventListener('click', () => this.toggleLoop());
    this.again.hidden = this.live;
    const help = element('details', {id: 'help'}, element('summary', {'aria-label': 'Keys',
                                                                     title: 'Keys'}, '?'),
      element('dl', {}, ...KEYS.flatMap(([key, what]) => [element('dt', {}, key),
                                                         element('dd', {}, what)]),
        element('dt', {}, 'plots'), element('dd', {},
          'click: that time, drag: move, wheel or shift-drag: zoom, double-click: all')));
    place.replaceChildren(element('div', {class: 'buttons'}, back, this.playButton, forth),
      this.shownTime, this.slider, this.choice, this.again, help);
    this.sayPlaying();
  }

  options(id, label, values, chosen, text) {
    this.select = element('select', {id, 'aria-label': label}, ...values.map((one) => element(
      'option', {value: String(one)}, text(one))));
    this.select.value = String(chosen);
    this.select.addEventListener('change', () => {
      this[id] = Number(this.select.value);
      this.changed();
    });
    return this.select;
  }

  fromSlider() {
    return this.source.begin + Number(this.slider.value) * (this.source.end - this.source.begin);
  }

  toggle() {
    this.playing = !this.playing;
    if (this.playing && !this.live && this.time >= this.source.end) this.time = this.source.begin;
    this.sayPlaying();
    this.changed();
  }

  pause() { if (this.playing) this.toggle(); }

  toggleLoop() {
    this.loop = !this.loop;
    this.again.setAttribute('aria-pressed', this.loop);
  }

  sayPlaying() {
    const label = this.playing ? 'Pause' : this.live ? 'Follow' : 'Play';
    this.playButton.innerHTML = icon(this.playing ? 'pause' : 'play');
    this.playButton.setAttribute('aria-label', label);
    this.playButton.title = `${label} (space)`;
  }

  seek(time) {
    if (this.live) this.pause();
    this.time = clamp(time, this.source.begin, this.source.end);
    this.sought();
  }

  async step(direction) {
    this.pause();
    this.seek(await this.source.step(this.time, direction));
  }

  faster(direction) {
    const at = this.select.selectedIndex + direction;
    if (at < 0 || at >= this.select.options.length) return;
    this.select.selectedIndex = at;
    this.select.dispatchEvent(new Event('change'));
  }

  /* Move on by so many seconds of the watch; returns whether anything moved. */
  advance(seconds) {
    if (!this.playing) return false;
    if (this.live) {
      this.time = this.source.end;
      return true;
    }
    this.time += seconds * this.speed;
    if (this.time >= this.source.end) {
      this.time = this.loop ? this.source.begin : this.source.end;
      if (!this.loop) this.toggle();
    }
    return true;
  }

  show() {
    const {begin, end} = this.source;
    if (this.slider !== document.activeElement || this.playing || !this.slider.matches(':active'))
      this.slider.value = String(end > begin ? (this.time - begin) / (end - begin) : 0);
    const text = this.live && this.playing ? clock(this.time)
      : `${clock(this.time)} / ${clock(end)}`;
    this.shownTime.textContent = text;
    this.slider.setAttribute('aria-valuetext', `${this.time.toFixed(2)} seconds`);
  }

  key(e) {
    const {target} = e;
    if (e.ctrlKey || e.altKey || e.metaKey) return;
    const own = target.closest('input:not(#scrub), select, textarea, summary');
    if (own) return;
    if (e.key === ' ' && target.closest('button')) return;
    const second = e.shiftKey ? 1 : 0;
    const act = {
      ' ': () => this.toggle(),
      ArrowLeft: () => (second ? this.seek(this.time - 1) : this.step(-1)),
      ArrowRight: () => (second ? this.seek(this.time + 1) : this.step(1)),
      PageDown: target === this.slider && (() => this.seek(this.time - 1)),
      PageUp: target === this.slider && (() => this.seek(this.time + 1)),
      Home: () => this.seek(this.source.begin), End: () => this.seek(this.source.end),
      '[': () => this.faster(-1), ']': () => this.faster(1), l: () => this.toggleLoop(),
      '+': () => this.zoomed(0.5), '=': () => this.zoomed(0.5), '-': () => this.zoomed(2),
      '0': () => this.zoomed(Infinity),
    }[e.key];
    if (act) {
      e.preventDefault();
      act();
    }
  }
}
