// How the antennas do: levels by antenna and tone, faults, and the response of the selected UE.

import { font, themeColours } from './axes.js';
import { curve } from './curve.js';

const $ = (id) => document.getElementById(id);
const LOWEST = -30; // dB
const FAULTS = { dead: 'bad', weak: 'warn', saturated: 'warn' };

/** Levels of all antennas; `places` are [right, up] of each, in metres, or null for a line. */
export function showAntennas(report, array, places) {
  const { coherent_db: levels, faults = {}, frames } = report ?? {};
  $('antennas').hidden = !levels;
  if (!levels) return;
  const out = new Set(array.dead_antennas ?? []);
  const named = Object.entries(faults).map(([n, fault]) => `antenna ${n} ${fault}`);
  $('antennafaults').textContent = named.length ? named.join(', ') : `all ${levels.length - out.size} well`;
  $('antennafaults').classList.toggle('bad', named.length > 0);
  $('antennafaults').title = `over about ${frames} frames of all UEs`;
  if (places) board($('antennaplot'), levels, faults, out, places);
  else bars($('antennaplot'), levels, faults, out);
  curve($('toneplot'), {
    series: [{ x: report.tone_db.map((_, i) => i), y: report.tone_db, colour: 'a' }],
    x: { label: 'subcarrier' }, y: { label: 'dB', least: 6 },
  });
}

function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  Object.assign(canvas, { width: Math.round(canvas.clientWidth * ratio), height: Math.round(canvas.clientHeight * ratio) });
  const context = canvas.getContext('2d');
  context.font = font(ratio, 10.5);
  return [context, canvas.width, canvas.height, ratio, themeColours()];
}

const height = (level) => Math.max(0, Math.min(1, (level - LOWEST) / (6 - LOWEST)));
const colour = (n, faults, out, colours) => (out.has(n) ? colours.line : faults[n] ? colours[FAULTS[faults[n]]] : colours.a);

function bars(canvas, levels, faults, out) {
  const [context, wide, tall, ratio, colours] = prepared(canvas);
  const foot = tall - 15 * ratio;
  const left = 26 * ratio;
  const step = (wide - left) / levels.length;
  context.textBaseline = 'middle';
  context.textAlign = 'right';
  for (const level of [0, -10, -20]) {
    const y = foot - height(level) * foot;
    context.fillStyle = colours.line;
    context.fillRect(left, Math.round(y), wide - left, ratio);
    context.fillStyle = colours.quiet;
    context.fillText(`${level}`.replace('-', '−'), left - 4 * ratio, Math.max(y, 6 * ratio));
  }
  context.textAlign = 'center';
  const every = Math.ceil((levels.length * 22 * ratio) / (wide - left));
  levels.forEach((level, n) => {
    const bar = Math.max(height(level) * foot, 2 * ratio);
    context.fillStyle = colour(n, faults, out, colours);
    context.fillRect(left + n * step + 0.1 * step, foot - bar, 0.8 * step, bar);
    if (n % every === 0 || faults[n]) {
      context.fillStyle = faults[n] ? colours[FAULTS[faults[n]]] : colours.quiet;
      context.fillText(`${n}`, left + (n + 0.5) * step, tall - 6 * ratio);
    }
  });
}

/** Elements where they are, as somebody in front of the array sees them. */
function board(canvas, levels, faults, out, places) {
  const [context, wide, tall, ratio, colours] = prepared(canvas);
  const span = (i) => [Math.min(...places.map((p) => p[i])), Math.max(...places.map((p) => p[i]))];
  const [[left, right], [low, high]] = [span(0), span(1)];
  const size = 15 * ratio;
  const scale = Math.min((wide - 3 * size) / Math.max(right - left, 1e-9), (tall - 3 * size) / Math.max(high - low, 1e-9));
  context.textAlign = 'center';
  context.textBaseline = 'middle';
  levels.forEach((level, n) => {
    const x = wide / 2 + (places[n][0] - (left + right) / 2) * scale;
    const y = tall / 2 - (places[n][1] - (low + high) / 2) * scale;
    context.globalAlpha = 0.25 + 0.75 * height(level);
    context.fillStyle = colour(n, faults, out, colours);
    context.beginPath();
    context.arc(x, y, size * 0.9, 0, 7);
    context.fill();
    context.globalAlpha = 1;
    context.fillStyle = colours.text;
    context.fillText(`${n}`, x, y);
  });
}

/** Phases in degrees without turns, and without the slope that a plane wave (or one path) gives them. */
function straightened(phases) {
  let before = 0;
  const unwrapped = phases.map((phase, i) => (before = i ? phase + 2 * Math.PI * Math.round((before - phase) / (2 * Math.PI)) : phase));
  const middle = (phases.length - 1) / 2;
  const mean = unwrapped.reduce((sum, v) => sum + v, 0) / phases.length;
  const slope = unwrapped.reduce((sum, v, i) => sum + v * (i - middle), 0) / (unwrapped.reduce((sum, _, i) => sum + (i - middle) ** 2, 0) || 1);
  return unwrapped.map((v, i) => ((v - mean - slope * (i - middle)) * 180) / Math.PI);
}

/** Phase and level of one UE's newest frame, by antenna and by subcarrier; `line`: whether the antennas are in one. */
export function showResponse(found, line) {
  for (const [id, name, label] of [['uephase', 'antenna', 'antenna'], ['uetones', 'tone', 'subcarrier']]) {
    const levels = found[`${name}_db`] ?? [];
    const phases = found[`${name}_phase`] ?? [];
    const x = levels.map((_, i) => i);
    const straight = line || name === 'tone';
    const y = straight ? straightened(phases) : phases.map((phase) => (phase * 180) / Math.PI);
    const empty = 'waits for its next frame';
    curve($(`${id}level`), { series: [{ x, y: levels, colour: 'a' }], x: { label }, y: { label: 'dB', least: 6 }, empty });
    curve($(id), { series: [{ x, y, colour: 'b' }], x: { label }, y: { label: straight ? '° off a straight line' : '°', least: 40 }, empty });
  }
}
