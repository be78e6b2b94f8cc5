/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */

const NAMESPACE = 'http://www.w3.org/2000/svg';
const degrees = (angle) => angle * 180 / Math.PI;

export function svg(tag, attributes = {}, ...children) {
  const made = document.createElementNS(NAMESPACE, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

export const rotate = (angle) => `rotate(${degrees(angle).toFixed(3)})`;

const point = (radius, angle) =>
  `${(radius * Math.cos(angle)).toFixed(5)} ${(radius * Math.sin(angle)).toFixed(5)}`;

/* A link along x from its joint to its end, a little slimmer there. */
export function linkPath(length, radius) {
  const near = 0.62 * radius, far = 0.44 * radius;
  return `M0 ${near} L${length} ${far} A${far} ${far} 0 0 0 ${length} ${-far}`
    + ` L0 ${-near} A${near} ${near} 0 0 0 0 ${near} Z`;
}

/* A clock spring from the link's hub to the motor's ring; winding adds to its turns. */
export function springPath(radius, torsion) {
  const turns = 2 * Math.PI * 2.25 + torsion, steps = 72;
  let path = '';
  for (let k = 0; k <= steps; k++) {
    const share = k / steps;
    path += (k ? 'L' : 'M') + point(radius * (0.36 + 0.6 * share), turns * share);
  }
  return path;
}

/* The angle between link and motor as a filled piece of a ring. */
export function wedgePath(radius, torsion) {
  const inner = 1.5 * radius, outer = 2.0 * radius;
  const angle = Math.max(-6.2, Math.min(6.2, torsion));
  const large = Math.abs(angle) > Math.PI ? 1 : 0, way = angle > 0 ? 1 : 0;
  return `M${point(inner, 0)} L${point(outer, 0)} A${outer} ${outer} 0 ${large} ${way}`
    + ` ${point(outer, angle)} L${point(inner, angle)}`
    + ` A${inner} ${inner} 0 ${large} ${1 - way} ${point(inner, 0)} Z`;
}

/* One joint: housing, motor ring with teeth, spring, hub. Returns it and how to turn it. */
export function joint(radius, rigid, colour) {
  const wedge = svg('path', {class: 'wedge'});
  const ring = svg('g', {class: 'motor'},
    svg('circle', {r: 1.08 * radius, class: 'ring', 'stroke-width': 0.3 * radius}),
    svg('circle', {r: 1.3 * radius, class: 'teeth', 'stroke-width': 0.2 * radius,
                   'stroke-dasharray': `${1.3 * Math.PI * radius / 14}`}),
    svg('path', {class: 'pointer', d: `M${0.95 * radius} 0 L${1.62 * radius} 0`,
                 'stroke-width': 0.2 * radius}));
  const spring = svg('path', {class: 'spring', 'stroke-width': 0.1 * radius});
  const wound = svg('path', {class: 'wound', 'stroke-width': 0.13 * radius});
  const hub = [svg('circle', {r: 0.4 * radius, class: 'hub'}),
               svg('circle', {r: 0.16 * radius, class: 'pin'})];
  const group = svg('g', {class: 'joint', style: `--joint: var(${colour})`},
    svg('circle', {r: 1.4 * radius, class: 'housing'}), wedge, ring, spring, wound, ...hub);
  if (rigid) for (const part of [wedge, ring, spring, wound]) part.remove();
  return {group, turn(torsion, share) {
    if (rigid) return;
    const there = Number.isFinite(torsion);
    ring.setAttribute('transform', rotate(there ? torsion : 0));
    for (const path of [spring, wound]) path.setAttribute('d', springPath(radius, there ? torsion : 0));
    wound.style.opacity = there ? Math.min(1, share).toFixed(3) : 0;
    wedge.setAttribute('d', there ? wedgePath(radius, torsion) : '');
  }};
}

/* What the arm is bolted to. */
export function base(radius) {
  const size = 2.0 * radius;
  const bolts = [-1, 1].flatMap((x) => [-1, 1].map((y) =>
    svg('circle', {cx: 0.78 * size * x, cy: 0.78 * size * y, r: 0.16 * radius, class: 'bolt'})));
  return svg('g', {class: 'base'},
    svg('rect', {x: -size, y: -size, width: 2 * size, height: 2 * size, rx: 0.5 * radius}),
    ...bolts);
}
