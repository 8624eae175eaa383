// Pictures and tables for people to take away.

import { css } from './colours.js';
import { font } from './axes.js';

function save(blob, name) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export const stamp = () => new Date().toISOString().slice(0, 19).replace(/[-:]/g, '').replace('T', '-');

/** The whole chart as CSV, one UE a row, as `chachart export` has it; unknown values are empty. */
export function saveCsv(world, array, method) {
  const columns = world.columns.filter(({ name }) => world.present.has(name));
  const lines = [[...columns.map((column) => column.file_name), 'array', 'theta_method', 'rho_method'].join(',')];
  const text = (value, decimals) => (typeof value === 'bigint' ? `${value}` : Number.isFinite(value) ? `${Number(value.toFixed(decimals))}` : '');
  for (let i = 0; i < world.rows; i++) {
    lines.push([...columns.map(({ name, decimals }) => text(world[name][i], decimals)), array, method.theta, method.rho].join(','));
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
