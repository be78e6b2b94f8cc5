/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
import {clamp, lowerBound} from './numbers.js';

const MOST_CHUNKS = 40;   // kept of a bag
const LONGEST = 60;       // kept of the running loop [s]
const REOPEN = 1000;      // after the server has gone [ms]
export const GONE = 'gms_flex view has ended or cannot be reached';

/* Columns over time as the server sends them: one column after the other. */
class Table {
  constructor(buffer, columns) {
    this.data = new Float64Array(buffer);
    this.rows = this.data.length / columns.size;
    this.columns = columns;
    this.x = this.data.subarray(0, this.rows);
  }

  column(name) {
    const at = this.columns.get(name);
    return this.data.subarray(at * this.rows, (at + 1) * this.rows);
  }

  value(name, row) {
    return this.columns.has(name) ? this.data[this.columns.get(name) * this.rows + row] : NaN;
  }
}

export async function ask(path, options) {
  const answer = await fetch(path, options).catch(() => { throw new Error(GONE); });
  if (!answer.ok) throw new Error((await answer.json()).reason);
  return answer;
}

/* Ask for a change with the token of the page; returns the answer. */
export async function send(path, what) {
  const token = document.querySelector('meta[name=token]').content;
  return (await ask(path, {
    method: 'POST', headers: {'X-Token': token, 'Content-Type': 'application/json'},
    body: JSON.stringify(what)})).json();
}

/* A bag: frames come in chunks, the coarser the faster it plays. */
export class BagSource {
  constructor(session) {
    this.session = session;
    this.columns = new Map(session.columns.map((name, i) => [name, i]));
    this.begin = session.begin;
    this.end = session.end;
    this.period = session.period;
    this.level = 0;
    this.chunks = new Map();
    this.failed = () => {};
    this.arrived = () => {};
  }

  /* Frames of every 2^level-th sample are enough for so many seconds a frame. */
  setPace(seconds) {
    this.level = clamp(Math.floor(Math.log2(Math.max(seconds / this.period, 1))), 0, 20);
  }

  chunk(level, number) {
    const key = level + ':' + number;
    let entry = this.chunks.get(key);
    if (!entry) {
      entry = {table: null};
      entry.loaded = ask(`/api/frames?level=${level}&chunk=${number}`)
        .then((answer) => answer.arrayBuffer())
        .then((buffer) => {
          entry.table = new Table(buffer, this.columns);
          this.arrived();
        })
        .catch((error) => { this.chunks.delete(key); this.failed(error); });
      if (this.chunks.size >= MOST_CHUNKS) this.chunks.delete(this.chunks.keys().next().value);
    } else {
      this.chunks.delete(key);
    }
    this.chunks.set(key, entry);
    return entry;
  }

  place(time, level) {
    const span = this.session.chunk * this.period * 2 ** level;
    return Math.max(0, Math.floor((time + 1e-9) / span));
  }

  /* The newest sample at a time, as (name) => value; null while it is being loaded. */
  frame(time, level = this.level) {
    const number = this.place(time, level);
    const entry = this.chunk(level, number);
    const ahead = this.place(time + this.session.chunk * this.period * 2 ** level / 2, level);
    if (ahead !== number && time < this.end) this.chunk(level, ahead);
    if (!entry.table || !entry.table.rows) return null;
    const table = entry.table;
    const row = Math.max(0, lowerBound(table.rows, (i) => table.x[i], time + 1e-9) - 1);
    return (name) => table.value(name, row);
  }

  async ready(time, level = this.level) {
    await this.chunk(level, this.place(time, level)).loaded;
  }

  /* Time of the next sample, or of the one before. */
  async step(time, direction) {
    for (let number = this.place(time, 0), tries = 0; number >= 0 && tries < 50;
      number += direction, tries++) {
      const entry = this.chunk(0, number);
      await entry.loaded;
      const table = entry.table;
      if (!table) return time;
      const row = direction > 0 ? lowerBound(table.rows, (i) => table.x[i], time + 1e-7)
        : lowerBound(table.rows, (i) => table.x[i], time - 1e-7) - 1;
      if (row >= 0 && row < table.rows) return table.x[row];
    }
    return time;
  }

  async plots(from, to, points) {
    const answer = await ask(`/api/plots?from=${from}&to=${to}&points=${points}`);
    return new Table(await answer.arrayBuffer(), this.columns);
  }

  has(signal) { return Boolean(this.session.signals[signal]); }
}

/* Extremes of a segment of rows, as the server makes them of a bag. */
class Extremes {
  constructor(rows, columns, points) {
    this.rows = rows;
    this.columns = columns;
    const count = rows.length;
    this.edges = null;
    if (count > points) {
      const buckets = points >> 1;
      this.edges = Array.from({length: buckets + 1}, (_, b) => Math.round(count * b / buckets));
    }
    this.x = this.edges ? this.pairs((b, from, to) => [rows[from][0], rows[to - 1][0]])
      : rows.map((row) => row[0]);
  }

  pairs(make) {
    const out = new Float64Array(2 * (this.edges.length - 1));
    for (let b = 0; b + 1 < this.edges.length; b++)
      out.set(make(b, this.edges[b], this.edges[b + 1]), 2 * b);
    return out;
  }

  column(name) {
    const at = this.columns.get(name), rows = this.rows;
    if (!this.edges) return rows.map((row) => row[at]);
    return this.pairs(name.startsWith('stick') ? (b, from, to) => {
      let sum = 0, known = 0;
      for (let i = from; i < to; i++)
        if (Number.isFinite(rows[i][at])) { sum += rows[i][at]; known++; }
      return [sum / known, sum / known];
    } : (b, from, to) => {
      let low = -1, high = -1;
      for (let i = from; i < to; i++) {
        const value = rows[i][at];
        if (!Number.isFinite(value)) continue;
        if (low < 0 || value < rows[low][at]) low = i;
        if (high < 0 || value > rows[high][at]) high = i;
      }
      return low < 0 ? [NaN, NaN]
        : [rows[Math.min(low, high)][at], rows[Math.max(low, high)][at]];
    });
  }
}

/* The running loop: rows are pushed by the server and kept for a minute. */
export class LiveSource {
  constructor(session) {
    this.session = session;
    this.columns = new Map(session.columns.map((name, i) => [name, i]));
    this.rows = [];
    this.period = 0.002;
    this.failed = () => {};
    this.said = () => {};      // what is missing
    this.reported = () => {}; // of the robot, and of the controller
    this.outdated = () => {}; // the columns have changed
    this.seen = new Set();    // signals that had a number
    this.open();
  }

  get begin() { return this.rows.length ? this.rows[0][0] : 0; }
  get end() { return this.rows.length ? this.rows[this.rows.length - 1][0] : 0; }

  open() {
    this.events = new EventSource('/api/live');
    this.events.onmessage = (event) => this.take(JSON.parse(event.data));
    this.events.onerror = () => {
      this.said(GONE);
      this.events.close();
      if (!this.closed) setTimeout(() => this.outdated(), REOPEN);
    };
  }

  close() {
    this.closed = true;
    this.events.close();
  }

  take(message) {
    if (this.closed) return;
    if (message.version !== this.session.version) {
      this.close();
      this.outdated();
      return;
    }
    this.said(message.state);
    this.reported(message.robot || null, message.controller);
    if (!message.rows) return;
    const bytes = Uint8Array.from(atob(message.rows), (c) => c.charCodeAt(0));
    const data = new Float64Array(bytes.buffer), width = this.columns.size;
    for (let at = 0; at + width <= data.length; at += width)
      this.rows.push(data.subarray(at, at + width));
    this.columns.forEach((at, name) => {
      const signal = name.split('.')[0];
      if (!this.seen.has(signal) && Number.isFinite(data[data.length - width + at]))
        this.seen.add(signal);
    });
    const count = this.rows.length;
    if (count > 10) this.period = Math.max((this.end - this.rows[count - 10][0]) / 9, 1e-4);
    if (this.end - this.begin > 1.1 * LONGEST)
      this.rows = this.rows.slice(this.index(this.end - LONGEST));
  }

  setPace() {}

  index(time) { return lowerBound(this.rows.length, (i) => this.rows[i][0], time); }

  frame(time) {
    if (!this.rows.length) return null;
    const row = this.rows[Math.max(0, this.index(time + 1e-9) - 1)];
    return (name) => (this.columns.has(name) ? row[this.columns.get(name)] : NaN);
  }

  /* Root of the mean square of a column from a time on, NaN where nothing is known. */
  rms(name, from) {
    const at = this.columns.get(name);
    let sum = 0, count = 0;
    for (let i = this.index(from); i < this.rows.length; i++) {
      const value = this.rows[i][at];
      if (Number.isFinite(value)) { sum += value * value; count++; }
    }
    return Math.sqrt(sum / count);
  }

  async ready() {}

  async step(time, direction) {
    const row = direction > 0 ? this.index(time + 1e-7) : this.index(time - 1e-7) - 1;
    return this.rows[row] ? this.rows[row][0] : time;
  }

  async plots(from, to, points) {
    const first = Math.max(0, this.index(from) - 1), last = this.index(to) + 1;
    return new Extremes(this.rows.slice(first, last), this.columns, points);
  }

  has(signal) { return this.seen.has(signal); }
}
