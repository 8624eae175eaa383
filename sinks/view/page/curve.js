// Small line plots: axes with units, bands, marks, and the values under the pointer.

import { font, themeColours, ticks, tickText } from './axes.js';

const drawn = new WeakMap();

/**
 * Draw series over each other.
 * spec: {series: [{x, y, colour, name}], x: {label, range?}, y: {label, range?, least?, limits?}, bands: [[from, to]],
 *        least: the axis spans at least so much; limits: and shows nothing beyond;
 *        marks: [{x, colour, dashed, name}], empty}
 */
export function curve(canvas, spec) {
  if (!drawn.has(canvas)) {
    canvas.addEventListener('pointermove', (event) => hover(canvas, event.offsetX));
    canvas.addEventListener('pointerleave', () => hover(canvas, null));
  }
  drawn.set(canvas, { spec, at: drawn.get(canvas)?.at ?? null });
  draw(canvas);
}

/** Draw everything again: the theme or the width has changed. */
export function redraw(canvases) {
  for (const canvas of canvases) if (drawn.has(canvas)) draw(canvas);
}

function hover(canvas, at) {
  const state = drawn.get(canvas);
  if (!state) return;
  state.at = at;
  draw(canvas);
}

function range(arrays, { range: given, least = 0, limits = [-Infinity, Infinity] } = {}) {
  if (given) return given;
  let low = Infinity;
  let high = -Infinity;
  for (const array of arrays) {
    for (const v of array) {
      if (Number.isFinite(v)) {
        if (v < low) low = v;
        if (v > high) high = v;
      }
    }
  }
  if (low > high) return [0, 1];
  if (high - low < least) {
    const middle = Math.min(Math.max((low + high) / 2, limits[0] + least / 2), limits[1] - least / 2);
    [low, high] = [middle - least / 2, middle + least / 2];
  }
  const pad = high > low ? (high - low) * 0.06 : Math.abs(high) * 0.05 || 1;
  return [low - pad, high + pad];
}

function draw(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio);
  const height = Math.round(canvas.clientHeight * ratio);
  if (!width || !height) return;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const { spec, at } = drawn.get(canvas);
  const colours = themeColours();
  const context = canvas.getContext('2d');
  context.clearRect(0, 0, width, height);
  context.font = font(ratio, 10.5);
  const points = spec.series.filter((s) => s.x.length);
  if (!points.length) {
    context.fillStyle = colours.quiet;
    context.textAlign = 'center';
    context.fillText(spec.empty ?? 'nothing yet', width / 2, height / 2);
    return;
  }
  const [xLow, xHigh] = spec.x.range ?? tight(points.map((s) => s.x));
  const [yLow, yHigh] = range(points.map((s) => s.y), spec.y);
  const yTicks = ticks(yLow, yHigh, height / (32 * ratio));
  const wide = Math.max(...yTicks.map((v) => context.measureText(tickText(v, yTicks)).width), 0);
  const box = { left: wide + 9 * ratio, right: width - 6 * ratio, top: 15 * ratio, bottom: height - 17 * ratio };
  const frame = {
    box, ratio, colours,
    px: (v) => box.left + ((v - xLow) / (xHigh - xLow || 1)) * (box.right - box.left),
    py: (v) => box.bottom - ((v - yLow) / (yHigh - yLow || 1)) * (box.bottom - box.top),
    xAt: (p) => xLow + ((p - box.left) / (box.right - box.left)) * (xHigh - xLow),
  };
  axes(context, frame, spec, ticks(xLow, xHigh, width / (75 * ratio)), yTicks);
  lines(context, frame, spec, points);
  if (at !== null) readout(context, frame, spec, points, frame.xAt(at * ratio));
  else legend(context, frame, spec, points);
}

function tight(arrays) {
  const [low, high] = range(arrays);
  const pad = ((high - low) * 0.06) / 1.12;
  return [low + pad, high - pad];
}

function axes(context, { box, ratio, colours, px, py }, spec, xTicks, yTicks) {
  context.lineWidth = ratio;
  context.strokeStyle = colours.line;
  context.fillStyle = colours.quiet;
  context.textAlign = 'right';
  context.textBaseline = 'middle';
  context.beginPath();
  for (const v of yTicks) {
    const y = Math.round(py(v)) + 0.5;
    context.moveTo(box.left, y);
    context.lineTo(box.right, y);
    context.fillText(tickText(v, yTicks), box.left - 5 * ratio, y);
  }
  context.stroke();
  context.textBaseline = 'top';
  context.textAlign = 'center';
  const unitWidth = context.measureText(spec.x.label).width;
  for (const v of xTicks) {
    const x = px(v);
    if (x < box.right - unitWidth - 14 * ratio && x >= box.left - 1) context.fillText(tickText(v, xTicks), x, box.bottom + 4 * ratio);
  }
  context.textAlign = 'right';
  context.fillText(spec.x.label, box.right, box.bottom + 4 * ratio);
  context.textAlign = 'left';
  context.textBaseline = 'top';
  context.fillText(spec.y.label, box.left, 0);
}

function lines(context, { box, ratio, colours, px, py }, spec, points) {
  context.save();
  context.beginPath();
  context.rect(box.left, box.top - 2 * ratio, box.right - box.left, box.bottom - box.top + 4 * ratio);
  context.clip();
  context.fillStyle = colours.band;
  for (const [from, to] of spec.bands ?? []) {
    const left = px(from);
    context.fillRect(left, box.top, Math.max(px(to) - left, 2 * ratio), box.bottom - box.top);
  }
  for (const { x, colour, dashed } of spec.marks ?? []) {
    context.strokeStyle = colours[colour];
    context.setLineDash(dashed ? [4 * ratio, 3 * ratio] : []);
    context.lineWidth = ratio;
    context.beginPath();
    context.moveTo(px(x), box.top);
    context.lineTo(px(x), box.bottom);
    context.stroke();
  }
  context.setLineDash([]);
  context.lineJoin = 'round';
  context.lineWidth = 1.6 * ratio;
  for (const { x, y, colour } of points) {
    context.strokeStyle = colours[colour];
    context.beginPath();
    let down = false;
    for (let i = 0; i < x.length; i++) {
      if (!Number.isFinite(y[i])) {
        down = false;
        continue;
      }
      if (down) context.lineTo(px(x[i]), py(y[i]));
      else context.moveTo(px(x[i]), py(y[i]));
      down = true;
    }
    context.stroke();
    if (x.length === 1) {
      context.fillStyle = colours[colour];
      context.fillRect(px(x[0]) - 2 * ratio, py(y[0]) - 2 * ratio, 4 * ratio, 4 * ratio);
    }
  }
  context.restore();
}

/** Names of the series (and of marks that have one) in their colours, top right. */
function legend(context, { box, colours, ratio }, spec, points) {
  const named = [...points, ...(spec.marks ?? [])].filter((s) => s.name);
  context.textAlign = 'right';
  context.textBaseline = 'top';
  let right = box.right;
  for (const { name, colour } of named.reverse()) {
    context.fillStyle = colours[colour];
    context.fillText(name, right, 0);
    right -= context.measureText(name).width + 10 * ratio;
  }
}

function readout(context, { box, ratio, colours, px }, spec, points, where) {
  const nearest = (x) => x.reduce((best, v, i) => (Math.abs(v - where) < Math.abs(x[best] - where) ? i : best), 0);
  const at = points[0].x[nearest(points[0].x)];
  context.strokeStyle = colours.quiet;
  context.lineWidth = ratio;
  context.beginPath();
  context.moveTo(px(at), box.top);
  context.lineTo(px(at), box.bottom);
  context.stroke();
  const digits = (v) => (Math.abs(v) >= 1000 ? v.toFixed(0) : v.toPrecision(4)).replace('-', '−');
  const values = points.map((s) => `${s.name ?? ''} ${digits(s.y[nearest(s.x)])}`.trim()).join(', ');
  context.fillStyle = colours.text;
  context.textAlign = 'right';
  context.textBaseline = 'top';
  context.fillText(`${values} at ${digits(at)}`, box.right, 0);
}
