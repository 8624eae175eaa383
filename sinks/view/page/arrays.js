// Several arrays: how each does, and what each says of the selected UE.

import { curve } from './curve.js';
import { number } from './panels.js';

const $ = (id) => document.getElementById(id);
const DEGREES = 180 / Math.PI;
const WORTH_DB = -20; // a bearing that is weaker against the best array's is not drawn
const COLOURS = ['a', 'b', 'accent', 'good', 'warn', 'bad'];

/** A table of the arrays: what they hear, how late their clocks are, and how their sources do. */
export function showArrays({ arrays = [], sources = [] }) {
  $('arrays').hidden = arrays.length < 2;
  const quiet = (name) => sources.find((source) => source.name.split(', ').includes(name));
  $('arraytable').tBodies[0].replaceChildren(...arrays.map(({ name, share, ...clock }) => {
    const row = document.createElement('tr');
    const source = quiet(name);
    const silent = source && !source.ended && source.live && source.quiet_s > 3;
    const texts = [
      name,
      `${Math.round(100 * share)} %`,
      lateness(clock),
      silent ? `nothing for ${source.quiet_s.toFixed(0)} s` : source && source.pid === null && !source.ended ? 'restarting' : 'heard',
    ];
    for (const text of texts) row.insertCell().textContent = text;
    row.className = silent ? 'warn' : '';
    return row;
  }));
}

/** How late a clock is, how surely, and what of it calibration does not take off. */
function lateness({ offset_ns: offset, offset_std_ns: std = null, drift_ns: drift = null }) {
  if (offset === null) return '–';
  const about = std === null ? '' : ` ± ${number(std, 1)}`;
  const left = drift === null ? '' : `, ${number(drift, 1)} uncorrected`;
  return `${number(offset, 2)}${about} ns${left}`;
}

/** Power over bearing and over range, a line an array; gives the bearings that are worth drawing. */
export function showBearings(spectrum) {
  const arrays = spectrum?.arrays ?? [];
  $('bearings').hidden = arrays.length < 2;
  if (arrays.length < 2) return [];
  const decibels = (values) => {
    const top = Math.max(...values);
    return values.map((v) => Math.max(10 * Math.log10(v / top), -40));
  };
  const line = (grid, values, scale) => (one, i) => ({ x: one[grid].map((v) => v * scale), y: decibels(one[values]), colour: COLOURS[i % COLOURS.length], name: one.name });
  curve($('bearingplot'), {
    series: arrays.map(line('bearing_grid_rad', 'bearing_spectrum', DEGREES)),
    x: { label: '°, from x to y' }, y: { label: 'dB' },
  });
  curve($('farplot'), { series: arrays.map(line('rho_grid_m', 'rho_spectrum', 1)), x: { label: 'm' }, y: { label: 'dB' } });
  const best = Math.max(...arrays.map((one) => one.power_db));
  return arrays.filter((one) => one.power_db - best > WORTH_DB).map(({ name, at, bearing_rad: angle, share }) => ({ name, at, angle, share }));
}
