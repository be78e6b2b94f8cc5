/* Copyright 2026 The gms_flex_control authors
   Licensed under the Apache License, Version 2.0; see the LICENSE file. */
(function () {
  'use strict';

  const payload = JSON.parse(document.getElementById('report-data').textContent);
  const charts = [];
  const decoded = [];

  /* ---- data ------------------------------------------------------------------------- */

  function array(index) {
    if (!decoded[index]) {
      const [type, text] = payload.arrays[index];
      const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      decoded[index] = type === 'f8' ? new Float64Array(bytes.buffer)
                                     : new Float32Array(bytes.buffer);
    }
    return decoded[index];
  }

  function lowerBound(x, value) {
    let lo = 0, hi = x.length;
    while (lo < hi) {
      const mid = (lo + hi) >> 1;
      if (x[mid] < value) lo = mid + 1; else hi = mid;
    }
    return lo;
  }

  const orNull = (v) => (Number.isFinite(v) ? v : null);

  /* Smallest and largest value of each bucket in the order they occur: peaks survive. */
  function decimate(y, edges) {
    const out = [];
    for (let b = 0; b + 1 < edges.length; b++) {
      let low = -1, high = -1;
      for (let i = edges[b]; i < edges[b + 1]; i++) {
        if (!Number.isFinite(y[i])) continue;
        if (low < 0 || y[i] < y[low]) low = i;
        if (high < 0 || y[i] > y[high]) high = i;
      }
      out.push(low < 0 ? null : y[Math.min(low, high)], low < 0 ? null : y[Math.max(low, high)]);
    }
    return out;
  }

  /* What uPlot is given for the window [min, max]: every sample if few, else extremes. */
  function view(chart, min, max) {
    const first = Math.max(0, lowerBound(chart.x, min) - 1);
    const last = Math.min(chart.x.length, lowerBound(chart.x, max) + 2);
    const buckets = Math.max(200, Math.ceil(chart.box.clientWidth * 1.5));
    if (last - first <= 4 * buckets)
      return [chart.x, ...chart.ys].map((v) => Array.from(v.subarray(first, last), orNull));
    const edges = [];
    for (let b = 0; b <= buckets; b++)
      edges.push(first + Math.round((last - first) * b / buckets));
    const x = [];
    for (let b = 0; b < buckets; b++)
      x.push(chart.x[edges[b]], chart.x[edges[b + 1] - 1]);
    return [x, ...chart.ys.map((y) => decimate(y, edges))];
  }

  /* ---- looks ------------------------------------------------------------------------ */

  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  function format(value) {
    if (value == null) return '–';
    if (value === 0) return '0';
    const size = Math.abs(value);
    return (size < 1e-3 || size >= 1e5 ? value.toExponential(3) : value.toPrecision(4))
      .replace('-', '−');
  }

  function tickLabels(u, ticks, axis, space, step) {
    let places = 0;
    while (places < 6 && Math.abs(step * 10 ** places - Math.round(step * 10 ** places)) > 1e-6)
      places++;
    return ticks.map((v) => (v == null ? '' : v === 0 ? '0'
      : places > 5 || Math.abs(v) >= 1e6 ? v.toExponential(1) : v.toFixed(places))
      .replace('-', '−'));
  }

  function axisWidth(u, labels) {
    return 18 + 7 * Math.max(3, ...(labels || []).map((s) => s.length));
  }

  function range(chart, lo, hi) {
    if (chart.yRange) return chart.yRange;
    if (lo == null || hi == null) return [-1, 1];
    const pad = hi > lo ? 0.06 * (hi - lo) : Math.abs(hi) * 0.1 || 1e-3;
    return [lo - pad, hi + pad];
  }

  function options(chart) {
    const axis = {
      stroke: css('--muted'), grid: {stroke: css('--grid'), width: 1},
      ticks: {stroke: css('--grid'), width: 1, size: 5}, font: '12px system-ui, sans-serif',
      labelFont: '12px system-ui, sans-serif', labelSize: 18, labelGap: 0, gap: 4,
      values: tickLabels,
    };
    return {
      ...size(chart),
      scales: {x: {time: false}, y: {range: (u, lo, hi) => range(chart, lo, hi)}},
      axes: [{...axis, label: chart.spec.x_label, size: 30},
             {...axis, label: chart.spec.y_label, size: axisWidth, space: 28}],
      cursor: {y: false, drag: {x: false, y: false},
               sync: {key: 'group:' + chart.spec.group, setSeries: false, scales: ['x', null]},
               points: {show: true, size: 6}},
      legend: {live: true},
      series: [
        {label: chart.spec.x_label.replace(/ ?\[.*/, ''), value: (u, v) => format(v)},
        ...chart.spec.series.map((s, i) => ({
          label: s.label, show: chart.shown[i], stroke: css('--' + s.role),
          width: s.dashed ? 1.4 : 1.6, dash: s.dashed ? [6, 4] : undefined,
          points: {show: (u) => u.data[0].length < 60}, value: (u, v) => format(v)})),
      ],
      hooks: {setSeries: [(u, i) => { if (i) chart.shown[i - 1] = u.series[i].show; }]},
    };
  }

  function draw(chart) {
    if (chart.plot) chart.plot.destroy();
    chart.plot = new uPlot(options(chart), view(chart, chart.min, chart.max), chart.box);
    chart.plot.setScale('x', {min: chart.min, max: chart.max});
    chart.plot.root.querySelectorAll('.u-series th').forEach((entry) => {
      entry.tabIndex = 0;
      entry.addEventListener('keydown', (e) => {
        if (e.key === 'Enter' || e.key === ' ') { e.preventDefault(); entry.click(); }
      });
    });
    listen(chart, chart.plot.over);
  }

  /* The height of the plot is the least one of its box, as report.css has it; the legend goes
     below it, in as many lines as it needs. */
  const size = (chart) => ({width: chart.box.clientWidth,
                            height: Math.round(parseFloat(getComputedStyle(chart.box).minHeight))});

  function fit(chart) {
    if (chart.root.closest('details:not([open])')) return;  /* drawn when it is first seen */
    const {width, height} = size(chart);
    if (!chart.plot) draw(chart);
    if (chart.plot.width === width && chart.plot.height === height) return;
    chart.plot.setSize({width, height});
    refresh(chart);
  }

  /* ---- pan and zoom: one x window per group ----------------------------------------- */

  const group = (chart) => charts.filter((c) => c.spec.group === chart.spec.group);

  function show(chart, min, max) {
    const members = group(chart);
    const low = Math.min(...members.map((c) => c.first));
    const high = Math.max(...members.map((c) => c.last));
    const width = Math.min(Math.max(max - min, (high - low) * 1e-6), high - low);
    min = Math.min(Math.max(min, low), high - width);
    for (const member of members) {
      member.min = min;
      member.max = min + width;
      refresh(member);
    }
  }

  function refresh(chart) {
    if (chart.pending || !chart.plot) return;
    chart.pending = requestAnimationFrame(() => {
      chart.pending = 0;
      chart.plot.setData(view(chart, chart.min, chart.max), false);
      chart.plot.setScale('x', {min: chart.min, max: chart.max});
    });
  }

  function reset(chart) {
    group(chart).forEach((member) => { member.yRange = null; });
    show(chart, -Infinity, Infinity);
  }

  function zoom(chart, centre, factor) {
    show(chart, centre - (centre - chart.min) * factor, centre + (chart.max - centre) * factor);
  }

  function zoomY(chart, centre, factor) {
    const {min, max} = chart.plot.scales.y;
    chart.yRange = [centre - (centre - min) * factor, centre + (max - centre) * factor];
    refresh(chart);
  }

  function listen(chart, over) {
    const plot = chart.plot;
    const down = new Map();
    let start = null;
    const at = (e) => {
      const box = over.getBoundingClientRect();
      return [Math.min(Math.max(e.clientX - box.left, 0), box.width),
              Math.min(Math.max(e.clientY - box.top, 0), box.height)];
    };
    over.tabIndex = 0;

    over.addEventListener('pointerdown', (e) => {
      if (e.button) return;
      over.setPointerCapture(e.pointerId);
      down.set(e.pointerId, at(e));
      const [x, y] = at(e);
      start = {x, y, min: chart.min, max: chart.max, yRange: chart.yRange,
               box: e.shiftKey || document.body.classList.contains('box'),
               spread: down.size === 2 ? spread(down) : 0};
    });

    over.addEventListener('pointermove', (e) => {
      if (e.movementX || e.movementY) chart.armed = true;
      if (!down.has(e.pointerId)) return;
      down.set(e.pointerId, at(e));
      const [x, y] = at(e), size = over.getBoundingClientRect();
      const perPixel = (start.max - start.min) / size.width;
      if (start.spread) {
        const [a, b] = [...down.values()];
        const factor = start.spread / Math.max(spread(down), 10);
        const centre = start.min + perPixel * (a[0] + b[0]) / 2;
        show(chart, centre - (centre - start.min) * factor, centre + (start.max - centre) * factor);
      } else if (start.box) {
        plot.setSelect({left: Math.min(x, start.x), top: Math.min(y, start.y),
                        width: Math.abs(x - start.x), height: Math.abs(y - start.y)}, false);
      } else {
        show(chart, start.min - (x - start.x) * perPixel, start.max - (x - start.x) * perPixel);
        if (start.yRange) {
          const step = (start.yRange[1] - start.yRange[0]) * (y - start.y) / size.height;
          chart.yRange = start.yRange.map((v) => v + step);
        }
      }
    });

    const release = (e) => {
      if (!down.delete(e.pointerId) || !start) return;
      const {left, top, width, height} = plot.select;
      if (start.box && e.type === 'pointerup' && (width > 5 || height > 5)) {
        if (height > 5)
          chart.yRange = [plot.posToVal(top + height, 'y'), plot.posToVal(top, 'y')];
        if (width > 5)
          show(chart, plot.posToVal(left, 'x'), plot.posToVal(left + width, 'x'));
        else
          refresh(chart);
      }
      plot.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
      if (start.spread) down.clear();
    };
    over.addEventListener('pointerup', release);
    over.addEventListener('pointercancel', release);
    over.addEventListener('dblclick', () => reset(chart));

    /* the wheel keeps scrolling the page until the pointer was moved over the plot */
    over.addEventListener('wheel', (e) => {
      if (!chart.armed && !e.ctrlKey) return;
      e.preventDefault();
      const [x, y] = at(e);
      const delta = (e.deltaY || e.deltaX) * (e.deltaMode === 1 ? 20 : 1);
      const factor = Math.exp(Math.max(-1, Math.min(1, delta * 0.002)));
      if (e.shiftKey) zoomY(chart, plot.posToVal(y, 'y'), factor);
      else zoom(chart, plot.posToVal(x, 'x'), factor);
    }, {passive: false});

    over.addEventListener('keydown', (e) => {
      const width = chart.max - chart.min, centre = (chart.max + chart.min) / 2;
      const act = {
        ArrowLeft: () => show(chart, chart.min - width / 5, chart.max - width / 5),
        ArrowRight: () => show(chart, chart.min + width / 5, chart.max + width / 5),
        '+': () => zoom(chart, centre, 0.7), '-': () => zoom(chart, centre, 1 / 0.7),
        '0': () => reset(chart), Escape: () => reset(chart),
      }[e.key];
      if (act) { e.preventDefault(); act(); }
    });
  }

  function spread(down) {
    const [a, b] = [...down.values()];
    return Math.abs(a[0] - b[0]);
  }

  /* ---- start ------------------------------------------------------------------------ */

  function begin(spec, index) {
    const root = document.getElementById('chart-' + index);
    const x = array(spec.x);
    const chart = {
      spec, root, box: root.querySelector('.plot'), x, ys: spec.series.map((s) => array(s.y)),
      first: x[0], last: x[x.length - 1], min: 0, max: 0, yRange: null, armed: false,
      shown: spec.series.map((s) => !s.hidden), pending: 0, plot: null,
    };
    charts.push(chart);
    root.querySelector('[data-act=reset]').addEventListener('click', () => reset(chart));
    root.querySelector('[data-act=large]').addEventListener('click', (e) => {
      e.target.setAttribute('aria-pressed', root.classList.toggle('large'));
      fit(chart);  /* where only its height is another one, nothing else reports it */
    });
    root.querySelector('[data-act=box]').addEventListener('click', () => {
      const on = document.body.classList.toggle('box');
      document.querySelectorAll('[data-act=box]').forEach(
        (button) => button.setAttribute('aria-pressed', on));
    });
    new ResizeObserver(() => fit(chart)).observe(chart.box);
    return chart;
  }

  payload.charts.map(begin).forEach((chart) => {
    const members = group(chart);
    chart.min = Math.min(...members.map((c) => c.first));
    chart.max = Math.max(...members.map((c) => c.last));
    fit(chart);
  });
  addEventListener('resize', () => charts.forEach(fit));  /* large ones are as high as it allows */
  addEventListener('scroll', () => charts.forEach((c) => { c.armed = false; }), {passive: true});
  matchMedia('(prefers-color-scheme: dark)').addEventListener(
    'change', () => charts.filter((c) => c.plot).forEach(draw));
  /* paper shows everything */
  const details = document.querySelector('details');
  let folded = false;
  details?.addEventListener('toggle', () => charts.forEach(fit));
  addEventListener('beforeprint', () => {
    folded = details && !details.open;
    if (folded) { details.open = true; charts.forEach(fit); }
  });
  addEventListener('afterprint', () => { if (folded) details.open = false; });
  document.documentElement.dataset.charts = charts.length;
})();
