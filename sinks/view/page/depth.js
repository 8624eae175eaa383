// A UE in depth: its paths over angle and range, and how its spectra change with time.

import { font, themeColours } from './axes.js';

const $ = (id) => document.getElementById(id);
const DEGREES = 180 / Math.PI;
const ROWS = 60; // spectra that a waterfall holds, one a second
const NEAR_DB = -10; // a second path as strong as that makes deviations of one path too small

/** How many paths are strong enough to count. */
export const strongPaths = (found) => (found.paths ?? []).filter(([, , level]) => level > NEAR_DB).length;

/** Fill an image of levels, 0 (lowest) to 1, row by row from the top. */
function paint(context, colours, width, height, level) {
  const image = new ImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  for (let i = 0; i < pixels.length; i++) pixels[i] = colours[Math.round(255 * Math.max(0, Math.min(1, level(i % width, Math.floor(i / width)))))] | 0xff000000;
  const small = Object.assign(document.createElement('canvas'), { width, height });
  small.getContext('2d').putImageData(image, 0, 0);
  context.imageSmoothingEnabled = true;
  return small;
}

function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  Object.assign(canvas, { width: Math.round(canvas.clientWidth * ratio), height: Math.round(canvas.clientHeight * ratio) });
  const context = canvas.getContext('2d');
  context.font = font(ratio, 10.5);
  return [context, ratio, themeColours(), { left: 30 * ratio, top: 4 * ratio, width: canvas.width - 34 * ratio, height: canvas.height - 22 * ratio }];
}

function label(context, box, ratio, colours, [left, right], [low, high], unit) {
  context.fillStyle = colours.quiet;
  context.textBaseline = 'middle';
  context.textAlign = 'right';
  context.fillText(low, box.left - 4 * ratio, box.top + 6 * ratio);
  context.fillText(high, box.left - 4 * ratio, box.top + box.height - 6 * ratio);
  context.textAlign = 'left';
  const y = box.top + box.height + 9 * ratio;
  context.fillText(left, box.left, y);
  context.textAlign = 'right';
  context.fillText(`${right} ${unit}`, box.left + box.width, y);
}

/** The picture over angle and range with its paths, and where the chart has the UE: angle down, range across. */
export function showPaths(found, at, scalar, line) {
  const { db, angle_rad: angles, rho_m: ranges, paths } = found;
  $('paths').closest('figure').hidden = !db;
  if (!db) return;
  const [context, ratio, colours, box] = prepared($('paths'));
  const small = paint(context, scalar, ranges.length, angles.length, (x, y) => 1 + db[y][x] / 30);
  context.drawImage(small, box.left, box.top, box.width, box.height);
  const span = ranges[1] * ranges.length;
  const place = (angle, range) => [box.left + (range / span) * box.width, box.top + (angle / Math.PI) * box.height];
  context.lineWidth = 1.5 * ratio;
  context.strokeStyle = '#fff';
  for (const [angle, range] of paths) {
    context.beginPath();
    context.arc(...place(angle, range), 5 * ratio, 0, 7);
    context.stroke();
  }
  const [x, y] = place(at.angle, at.rho % span);
  context.strokeStyle = '#ff3b30';
  context.beginPath();
  for (const [dx, dy] of [[5, 5], [5, -5]]) {
    context.moveTo(x - dx * ratio, y - dy * ratio);
    context.lineTo(x + dx * ratio, y + dy * ratio);
  }
  context.stroke();
  label(context, box, ratio, colours, ['0', span.toFixed(0)], line ? ['0°', '180°'] : ['90°', '−90°'], 'm');
  const text = paths.map(([angle, range, level]) => `${((line ? angle : Math.PI / 2 - angle) * DEGREES).toFixed(0)}°, ${range.toFixed(0)} m, ${level.toFixed(0)} dB`);
  $('pathlist').textContent = `${paths.length === 1 ? 'one path' : `${paths.length} paths`}: ${text.join(' · ')}`.replaceAll('-', '−');
}

/** Spectra of one UE, second after second. */
export class Waterfall {
  constructor() {
    this.ue = null;
  }

  /** Take the newest spectrum of a UE in; another UE begins anew. */
  take(ue, spectrum) {
    if (ue !== this.ue) Object.assign(this, { ue, theta: [], rho: [] });
    for (const kind of ['theta', 'rho']) {
      const values = spectrum[`${kind}_spectrum`];
      if (!values || !values.some(Number.isFinite)) continue;
      const top = Math.max(...values.filter(Number.isFinite));
      this[kind].push({ grid: spectrum[kind === 'theta' ? 'theta_grid_rad' : 'rho_grid_m'], level: values.map((v) => 1 + (10 * Math.log10(v / top)) / 30) });
      if (this[kind].length > ROWS) this[kind].shift();
    }
  }

  /** Newest at the top. */
  show(scalar) {
    for (const [kind, id, scale, unit] of [['theta', 'thetafall', DEGREES, '°'], ['rho', 'rhofall', 1, 'm']]) {
      const rows = this[kind];
      const canvas = $(id);
      canvas.closest('figure').hidden = rows.length < 2;
      if (rows.length < 2) continue;
      const [context, ratio, colours, box] = prepared(canvas);
      const width = Math.min(rows.at(-1).level.length, 360);
      const small = paint(context, scalar, width, ROWS, (x, y) => {
        const row = rows[rows.length - 1 - y];
        return row ? row.level[Math.floor((x / width) * row.level.length)] : 0;
      });
      context.drawImage(small, box.left, box.top, box.width, box.height);
      const { grid } = rows.at(-1);
      label(context, box, ratio, colours, [(grid[0] * scale).toFixed(0), (grid.at(-1) * scale).toFixed(0)], ['now', `−${ROWS} s`], unit);
    }
  }
}
