/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */

export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

export const css = (name) =>
  getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export const calm = matchMedia('(prefers-reduced-motion: reduce)');

export const colour = (joint) => `--c${joint % 7}`;

/* A number as people read it: four digits, a true minus. */
export function format(value, digits = 4) {
  if (value == null || !Number.isFinite(value)) return '–';
  if (value === 0) return '0';
  const size = Math.abs(value);
  return (size < 1e-3 || size >= 1e5 ? value.toExponential(digits - 2) : value.toPrecision(digits))
    .replace('-', '−');
}

/* With a fixed number of decimals, so that a changing number does not jump. */
export function fixed(value, places) {
  if (value == null || !Number.isFinite(value)) return '–';
  const text = value.toFixed(places);
  return (Number(text) === 0 ? text.replace('-', '') : text).replace('-', '−');
}

export function clock(seconds) {
  if (!Number.isFinite(seconds)) return '–';
  const all = Math.round(Math.abs(seconds) * 100) / 100;
  const whole = Math.floor(all / 60), rest = (all - 60 * whole).toFixed(2);
  return whole ? `${whole}:${rest.padStart(5, '0')} min` : `${rest} s`;
}

/* First index whose x is at or beyond a value. */
export function lowerBound(count, x, value) {
  let low = 0, high = count;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (x(middle) < value) low = middle + 1; else high = middle;
  }
  return low;
}

/* The factor from 1, 2, 5, 10, ... that brings a largest value closest below a wanted one. */
export function niceFactor(largest, wanted) {
  if (!(largest > 0)) return 1;
  let best = 1;
  for (let power = 1; power <= 1e5; power *= 10)
    for (const step of [1, 2, 5]) if (step * power * largest <= wanted) best = step * power;
  return best;
}

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes))
    if (name in made && name !== 'list' && typeof value !== 'string') made[name] = value;
    else made.setAttribute(name, value);
  made.append(...children);
  return made;
}
