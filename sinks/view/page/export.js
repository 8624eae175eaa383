// Pictures and tables for people to take away.

import { css } from './colours.js';
import { font, ticks, tickText } from './axes.js';
import { pdfOf } from './pdf.js';

function save(blob, name) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export const stamp = () => new Date().toISOString().slice(0, 19).replace(/[-:]/g, '').replace('T', '-');

/** Text as a cell of CSV: no spreadsheet takes it for a formula, and no comma or quote ends it. */
function cell(text) {
  const harmless = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\r\n]/.test(harmless) ? `"${harmless.replaceAll('"', '""')}"` : harmless;
}

/** The whole chart as CSV, one UE a row, as `chachart export` has it; unknown values are empty. */
export function saveCsv(world, array, method) {
  const columns = world.columns.filter(({ name }) => world.present.has(name));
  const lines = [[...columns.map((column) => column.file_name), 'array', 'theta_method', 'rho_method'].join(',')];
  const text = (value, decimals) => (typeof value === 'bigint' ? `${value}` : Number.isFinite(value) ? `${Number(value.toFixed(decimals))}` : '');
  const words = [array, method.theta, method.rho].map(cell);
  for (let i = 0; i < world.rows; i++) {
    lines.push([...columns.map(({ name, decimals }) => text(world[name][i], decimals)), ...words].join(','));
  }
  save(new Blob([`${lines.join('\n')}\n`], { type: 'text/csv' }), `chart-${array}-${stamp()}.csv`);
}

/** What is seen, with a line that says what it is. */
export function savePng(picture, caption, array) {
  const { canvas, over, colours } = picture;
  const ratio = window.devicePixelRatio || 1;
  const foot = Math.round(30 * ratio);
  const sheet = Object.assign(document.createElement('canvas'), { width: canvas.width, height: canvas.height + foot });
  const context = sheet.getContext('2d');
  context.fillStyle = colours.plot;
  context.fillRect(0, 0, sheet.width, sheet.height);
  context.drawImage(canvas, 0, 0);
  context.drawImage(over, 0, 0);
  context.font = font(ratio, 12);
  context.textBaseline = 'middle';
  context.fillStyle = colours.quiet;
  context.fillText(caption, 14 * ratio, canvas.height + foot / 2);
  if (picture.colouring.effective(picture.world) !== 'truth') {
    const width = 160 * ratio;
    for (let i = 0; i < 256; i++) {
      context.fillStyle = css(picture.colouring.scalar[i]);
      context.fillRect(sheet.width - width - 14 * ratio + (i * width) / 256, canvas.height + foot / 3, width / 256 + 1, foot / 3);
    }
  }
  sheet.toBlob((blob) => save(blob, `chart-${array}-${stamp()}.png`), 'image/png');
}

const escaped = (text) => `${text}`.replace(/[&<>"]/g, (c) => ({ '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;' })[c]);

/** What is seen as SVG: every point a circle, with axes, caption and colour key. */
function drawn(picture, caption) {
  const { world, colouring, view, colours } = picture;
  const [width, height] = view.size;
  const packed = new Uint32Array(world.rows);
  colouring.paint(world, packed);
  const parts = [];
  const text = (x, y, words, anchor = 'middle') => parts.push(`<text x="${x.toFixed(1)}" y="${y.toFixed(1)}" text-anchor="${anchor}" fill="${colours.quiet}">${escaped(words)}</text>`);
  view.panes().forEach((pane, i) => {
    const { left, top, right, bottom, scale, x0, y0, title } = pane;
    const clip = `pane${i}`;
    parts.push(`<clipPath id="${clip}"><rect x="${left}" y="${top}" width="${right - left}" height="${bottom - top}"/></clipPath>`);
    const xs = ticks((left - x0) / scale, (right - x0) / scale, (right - left) / 90);
    const ys = ticks((y0 - bottom) / scale, (y0 - top) / scale, (bottom - top) / 70);
    const lines = [...xs.map((x) => `M${(x0 + x * scale).toFixed(1)} ${top}V${bottom}`), ...ys.map((y) => `M${left} ${(y0 - y * scale).toFixed(1)}H${right}`)];
    parts.push(`<path d="${lines.join('')}" stroke="${colours.line}" fill="none"/><rect x="${left}" y="${top}" width="${right - left}" height="${bottom - top}" stroke="${colours.line}" fill="none"/>`);
    for (const x of xs) text(x0 + x * scale, bottom + 16, tickText(x, xs));
    for (const y of pane.labelled ? ys : []) text(left - 6, y0 - y * scale + 4, tickText(y, ys), 'end');
    const truth = title === 'Truth';
    parts.push(`<g clip-path="url(#${clip})">`);
    for (let row = 0; row < world.rows; row++) {
      const x = x0 + (truth ? world.true_x : world.x)[row] * scale;
      const y = y0 - (truth ? world.true_y : world.y)[row] * scale;
      if (Number.isFinite(x + y)) parts.push(`<circle cx="${x.toFixed(1)}" cy="${y.toFixed(1)}" r="2.5" fill="${css(packed[row])}"/>`);
    }
    parts.push('</g>');
    if (view.titles.length > 1) text(left + 10, top + 20, title, 'start');
  });
  const said = colouring.measure(world);
  text(14, height + 18, caption, 'start');
  if (said.by !== 'truth') {
    const steps = Array.from({ length: 32 }, (_, i) => `<rect x="${width - 260 + i * 5}" y="${height + 8}" width="5.2" height="10" fill="${css(colouring.scalar[i * 8])}"/>`);
    parts.push(...steps);
    text(width - 266, height + 18, said.low, 'end');
    text(width - 94, height + 18, said.high, 'start');
  }
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height + 30}" font-family="sans-serif" font-size="11"><rect width="100%" height="100%" fill="${colours.plot}"/>${parts.join('')}</svg>`;
}

/** What is seen as a drawing for papers, SVG or PDF. */
export function saveDrawing(picture, caption, array, kind) {
  const svg = drawn(picture, caption);
  const [content, type] = kind === 'pdf' ? [pdfOf(svg), 'application/pdf'] : [svg, 'image/svg+xml'];
  save(new Blob([content], { type }), `chart-${array}-${stamp()}.${kind}`);
}
