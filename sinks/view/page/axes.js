// Ticks, grids and labels, shared by the chart and the small curves.

/** About `count` round values within [low, high]. */
export function ticks(low, high, count) {
  const span = high - low;
  if (!(span > 0) || !Number.isFinite(span)) return [];
  const rough = span / Math.max(1, count);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((m) => m * power >= rough * 0.75) * power;
  const values = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++) values.push(i * step + 0);
  return values;
}

/** A tick's text, with as many digits as the distance between ticks asks for. */
export function tickText(value, values) {
  const step = values.length > 1 ? Math.abs(values[1] - values[0]) : Math.abs(value) || 1;
  const digits = Math.min(9, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  return (Math.abs(value) < step * 1e-6 ? 0 : value).toFixed(digits).replace('-', '−');
}

/** The theme's colours, read once per theme from the style sheet. */
export function themeColours() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(
    ['plot', 'line', 'text', 'quiet', 'accent', 'a', 'b', 'band', 'shade', 'good', 'warn', 'bad', 'panel'].map((name) => [name, style.getPropertyValue(`--${name}`).trim()]),
  );
}

export const font = (ratio, size = 11) => `${size * ratio}px system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif`;

/** What the axes are called: metres only where the chart has a scale. */
export function axisNames(pose, relative) {
  const unit = relative ? 'no scale' : 'm';
  return pose?.world ? [`x (${unit})`, `y (${unit})`] : [`x, along broadside (${unit})`, `y, along the array (${unit})`];
}

/** One pane of the chart: grid, ticks, the array with where it looks, a scale bar where there is a scale, a title. */
export function drawPane(context, pane, colours, ratio, pose, axes, scaled) {
  const { left, top, right, bottom, scale, x0, y0 } = pane;
  const xs = ticks((left - x0) / scale, (right - x0) / scale, (right - left) / (90 * ratio));
  const ys = ticks((y0 - bottom) / scale, (y0 - top) / scale, (bottom - top) / (70 * ratio));
  context.save();
  context.lineWidth = ratio;
  context.strokeStyle = colours.line;
  context.font = font(ratio);
  context.fillStyle = colours.quiet;
  context.globalAlpha = 0.6;
  context.beginPath();
  for (const x of xs) {
    const at = Math.round(x0 + x * scale) + 0.5;
    context.moveTo(at, top);
    context.lineTo(at, bottom);
  }
  for (const y of ys) {
    const at = Math.round(y0 - y * scale) + 0.5;
    context.moveTo(left, at);
    context.lineTo(right, at);
  }
  context.stroke();
  context.globalAlpha = 1;
  context.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
  context.textAlign = 'center';
  context.textBaseline = 'top';
  for (const x of xs) context.fillText(tickText(x, xs), x0 + x * scale, bottom + 5 * ratio);
  context.textAlign = 'right';
  context.textBaseline = 'middle';
  for (const y of pane.labelled ? ys : []) {
    const at = y0 - y * scale;
    if (at > top + 5 * ratio && at < bottom - 2 * ratio) context.fillText(tickText(y, ys), left - 6 * ratio, at);
  }
  labels(context, pane, ratio, axes);
  const arrays = arraysOf(pose);
  for (const array of arrays) drawArray(context, pane, colours, ratio, array, arrays.length > 1);
  if (scaled) scaleBar(context, pane, colours, ratio);
  if (Number.isFinite(pose?.heading_deg)) compass(context, pane, colours, ratio, pose.heading_deg);
  if (pane.title) {
    context.font = `600 ${font(ratio, 12)}`;
    context.fillStyle = colours.text;
    context.textAlign = 'left';
    context.textBaseline = 'top';
    context.fillText(pane.title, left + 10 * ratio, top + 9 * ratio);
  }
  context.restore();
}

function labels(context, { left, top, right, bottom, labelled }, ratio, [x, y]) {
  context.textAlign = 'center';
  context.textBaseline = 'bottom';
  context.fillText(x, (left + right) / 2, bottom + 32 * ratio);
  if (!labelled) return;
  context.save();
  context.translate(left - 56 * ratio, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.textBaseline = 'top';
  context.fillText(y, 0, 0);
  context.restore();
}

/** A line's own chart: it is at the origin and looks along x. */
const OWN = { name: '', at: [0, 0], along: [0, 1], normal: [1, 0] };

/** The arrays that a pane shows, and where they are in its coordinates. */
export const arraysOf = (pose) => (pose?.world ? pose.arrays : [OWN]);

/** An array as a row of dots, and faint lines 60° to both sides of where it looks; its name where it is one of several. */
function drawArray(context, { left, top, right, bottom, x0, y0, scale }, colours, ratio, { name, at, along, normal }, named) {
  const [x, y] = [x0 + at[0] * scale, y0 - at[1] * scale];
  if (x < left || x > right || y < top || y > bottom) return;
  context.save();
  context.beginPath();
  context.rect(left, top, right - left, bottom - top);
  context.clip();
  context.strokeStyle = colours.quiet;
  context.globalAlpha = 0.35;
  context.setLineDash([4 * ratio, 6 * ratio]);
  const facing = Math.hypot(...normal) > 0.2 ? Math.atan2(normal[1], normal[0]) : null;
  context.beginPath();
  for (const side of facing === null ? [] : [-1, 1]) {
    const angle = facing + (side * Math.PI) / 3;
    context.moveTo(x, y);
    context.lineTo(x + Math.cos(angle) * 3000 * ratio, y - Math.sin(angle) * 3000 * ratio);
  }
  context.stroke();
  context.restore();
  context.fillStyle = colours.text;
  for (let i = -2; i <= 2; i++) context.fillRect(x + along[0] * i * 4 * ratio - 1.5 * ratio, y - along[1] * i * 4 * ratio - 1.5 * ratio, 3 * ratio, 3 * ratio);
  if (!named) return;
  context.font = font(ratio, 10.5);
  context.textAlign = 'center';
  context.textBaseline = 'middle';
  const away = Math.hypot(...normal) || 1;
  context.fillText(name, x - (normal[0] / away) * 16 * ratio, y + (normal[1] / away) * 12 * ratio);
}

function scaleBar(context, { left, bottom, scale }, colours, ratio) {
  const rough = (90 * ratio) / scale;
  const power = 10 ** Math.floor(Math.log10(rough));
  const length = [5, 2, 1].find((m) => m * power <= rough) * power;
  const [x, y] = [left + 12 * ratio, bottom - 12 * ratio];
  context.fillStyle = colours.text;
  context.fillRect(x, y, length * scale, 2 * ratio);
  for (const end of [x, x + length * scale - ratio]) context.fillRect(end, y - 3 * ratio, ratio, 8 * ratio);
  context.textAlign = 'left';
  context.textBaseline = 'bottom';
  context.fillText(length >= 1000 ? `${length / 1000} km` : `${Number(length.toPrecision(1))} m`, x, y - 4 * ratio);
}

/** An arrow to the north; `heading` is that of the chart's x axis, clockwise from north, in degrees. */
function compass(context, { right, top }, colours, ratio, heading) {
  context.save();
  context.translate(right - 24 * ratio, top + 26 * ratio);
  context.rotate(((90 - heading) * Math.PI) / 180);
  context.fillStyle = colours.text;
  context.beginPath();
  for (const [x, y] of [[0, -14], [6, 8], [0, 4], [-6, 8]]) context.lineTo(x * ratio, y * ratio);
  context.fill();
  context.textAlign = 'center';
  context.textBaseline = 'middle';
  context.fillText('N', 0, 16 * ratio);
  context.restore();
}
