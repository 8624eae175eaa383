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

/** One pane of the chart: grid, ticks in metres, the array, a title. */
export function drawPane(context, pane, colours, ratio) {
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
  labels(context, pane, ratio);
  drawArray(context, pane, colours, ratio);
  if (pane.title) {
    context.font = `600 ${font(ratio, 12)}`;
    context.fillStyle = colours.text;
    context.textAlign = 'left';
    context.textBaseline = 'top';
    context.fillText(pane.title, left + 10 * ratio, top + 9 * ratio);
  }
  context.restore();
}

function labels(context, { left, top, right, bottom, labelled }, ratio) {
  context.textAlign = 'center';
  context.textBaseline = 'bottom';
  context.fillText('x, along broadside (m)', (left + right) / 2, bottom + 32 * ratio);
  if (!labelled) return;
  context.save();
  context.translate(left - 56 * ratio, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.textBaseline = 'top';
  context.fillText('y, along the array (m)', 0, 0);
  context.restore();
}

function drawArray(context, { left, top, right, bottom, x0, y0 }, colours, ratio) {
  if (x0 < left || x0 > right || y0 < top || y0 > bottom) return;
  context.fillStyle = colours.text;
  for (let i = -2; i <= 2; i++) context.fillRect(x0 - 1.5 * ratio, y0 + i * 4 * ratio - 1.5 * ratio, 3 * ratio, 3 * ratio);
}
