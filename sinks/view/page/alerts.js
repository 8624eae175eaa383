// Alerts: what holds, what has come and gone, and the zones that they are about.

import { font } from './axes.js';

const $ = (id) => document.getElementById(id);
const SHOWN = 8; // of the last ones
let seen = null; // the number of the last one that was known

/** From a status; `toast` says aloud what is new. */
export function showAlerts({ active = [], recent = [], counts = {} }, toast) {
  $('alerts').hidden = !Object.keys(counts).length;
  const last = recent.at(-1)?.number ?? 0;
  for (const event of seen === null || last < seen ? [] : recent.filter(({ number }) => number > seen)) toast(`${event.alert}: ${event.text}`);
  seen = last;
  const lines = (events, text) => events.map((event) => Object.assign(document.createElement('li'), { textContent: text(event) }));
  const when = ({ time_ns: time }) => new Date(time / 1e6).toISOString().slice(11, 19);
  $('alertsnow').replaceChildren(...lines(active, ({ alert, text }) => `${alert}: ${text}`));
  $('alertsnow').hidden = !active.length;
  $('alertspast').replaceChildren(...lines(recent.slice(-SHOWN).reverse(), (event) => `${when(event)} ${event.alert}: ${event.text}`));
  $('alertsnone').hidden = active.length + recent.length > 0;
}

/** Draw outlines {name: corners} into a pane. */
export function drawZones(context, pane, zones, colours, ratio) {
  context.save();
  context.beginPath();
  context.rect(pane.left, pane.top, pane.right - pane.left, pane.bottom - pane.top);
  context.clip();
  context.lineWidth = 1.5 * ratio;
  context.strokeStyle = context.fillStyle = colours.accent;
  context.font = font(ratio, 11);
  for (const [name, corners] of Object.entries(zones)) {
    const at = corners.map(([x, y]) => [pane.x0 + x * pane.scale, pane.y0 - y * pane.scale]);
    context.beginPath();
    for (const [x, y] of at) context.lineTo(x, y);
    context.closePath();
    context.stroke();
    const top = at.reduce((a, b) => (b[1] < a[1] ? b : a));
    context.fillText(name, top[0] + 4 * ratio, top[1] + 14 * ratio);
  }
  context.restore();
}
