// The chart itself: when to draw, and in which order.

import { drawZones } from './alerts.js';
import { arraysOf, axisNames, drawPane, font, themeColours } from './axes.js';
import { Colouring } from './colours.js';
import { Scatter } from './scatter.js';
import { View } from './view.js';

const TRAIL_ALPHA = 120;
const TRAILS_EVERY_MS = 500;
const TRAILS_SHARE = 0.05; // trails may take such a share of the time: with very many UEs they are drawn less often
const GLIDE_MS = 70; // time constant with which points follow their estimates
const MOST_VELOCITIES = 1000; // with more UEs their lines would hide the chart
const OWN_PANE = 0.1; // share of UEs whose truth is known

export class Picture {
  /** `selected(row or -1)` is called on a click. */
  constructor(element, world, selected) {
    Object.assign(this, { element, world, zones: {} });
    [this.canvas, this.over] = element.querySelectorAll('canvas');
    this.context = this.canvas.getContext('2d', { alpha: false, willReadFrequently: true });
    this.scatter = new Scatter(this.context);
    this.colouring = new Colouring();
    this.truth = 'beside';
    this.trails = true;
    this.ue = null;
    this.hover = -1;
    this.drawn = 0;
    this.view = new View(element, {
      changed: () => (this.stale = this.dirty = true),
      picked: (x, y, kind) => selected(this.nearest(x, y, kind === 'touch' ? 28 : 14)),
      hovered: (x, y) => this.#hovered(x, y),
    });
    this.still = matchMedia('(prefers-reduced-motion: reduce)');
    new ResizeObserver(() => this.#resize()).observe(element);
    this.retheme(true);
    this.last = performance.now();
    requestAnimationFrame((now) => this.#frame(now));
  }

  retheme(dark) {
    this.colours = themeColours();
    this.colouring.setTheme(dark);
    this.stale = this.dirty = true;
  }

  /** What is drawn has changed; `ground`: even what seldom does. */
  touch(ground = false) {
    this.dirty = true;
    this.stale ||= ground;
  }

  /** What the user asked for, as far as a truth is known: a pane of its own is not for a few UEs of many. */
  get truthShown() {
    const known = this.truth === 'off' ? 0 : this.world.knownShare();
    return known === 0 ? 'off' : known < OWN_PANE ? 'under' : this.truth;
  }

  /** Show all UEs, their truths and the array; stays so until the user moves the view. */
  fit() {
    this.view.auto = true;
    const spans = this.#spans();
    if (!spans) return;
    this.fitted = spans;
    this.view.fit(...spans);
  }

  /** Fit again where the chart has outgrown the view, or become much smaller. */
  refit() {
    const spans = this.#spans();
    if (!this.view.auto || !spans) return;
    const fits = this.fitted?.every(([low, high], axis) => {
      const [from, to] = spans[axis];
      const slack = 0.03 * (high - low);
      return from > low - slack && to < high + slack && to - from > 0.8 * (high - low);
    });
    if (!fits) this.fit();
  }

  /** What there is to see, [x low, x high] and [y low, y high]; null before the first UE. */
  #spans() {
    const { world } = this;
    const spans = (columns) => {
      const found = columns.map((column) => world.spread(column, 0.001, 0.999)).filter(Boolean);
      return found.length ? [Math.min(...found.map((s) => s[0])), Math.max(...found.map((s) => s[1]))] : null;
    };
    const truth = this.truthShown !== 'off';
    const of = (axis, columns) => {
      const span = spans(columns);
      const there = arraysOf(this.pose).map(({ at }) => at[axis]);
      return span && [Math.min(span[0], ...there), Math.max(span[1], ...there)];
    };
    const x = of(0, truth ? [world.x, world.true_x] : [world.x]);
    return x && [x, of(1, truth ? [world.y, world.true_y] : [world.y])];
  }

  /** The row of the UE drawn nearest to a point in CSS pixels, or -1. */
  nearest(x, y, reach) {
    const pane = this.view.paneAt(x, y);
    if (!pane) return -1;
    const [xs, ys] = this.#coordinates(pane);
    let best = reach * reach;
    let row = -1;
    for (let i = 0; i < this.world.rows; i++) {
      const dx = pane.x0 + xs[i] * pane.scale - x;
      const dy = pane.y0 - ys[i] * pane.scale - y;
      const d = dx * dx + dy * dy;
      if (d < best) [best, row] = [d, i];
    }
    return row;
  }

  #coordinates(pane) {
    const { world } = this;
    return pane.title === 'Truth' ? [world.true_x, world.true_y] : [world.px, world.py];
  }

  #hovered(x, y) {
    const row = Number.isNaN(x) ? -1 : this.nearest(x, y, 10);
    if (row === this.hover) return;
    this.hover = row;
    this.dirty = true;
  }

  /** Zones by name: their corners. */
  enclose(zones = {}) {
    if (JSON.stringify(zones) === JSON.stringify(this.zones)) return;
    this.zones = zones;
    this.touch(true);
  }

  #resize() {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = this.view.size.map((v) => Math.max(1, Math.round(v * ratio)));
    for (const canvas of [this.canvas, this.over]) Object.assign(canvas, { width, height });
    this.stale = this.dirty = true;
    if (this.view.auto) this.fit();
  }

  #frame(now) {
    requestAnimationFrame((next) => this.#frame(next));
    const fraction = this.still.matches ? 1 : 1 - Math.exp(-(now - this.last) / GLIDE_MS);
    this.last = now;
    const tolerance = 0.2 / this.view.scale;
    if (this.world.glide(fraction, tolerance)) this.dirty = true;
    if (!this.dirty || this.canvas.width < 2) return;
    this.draw();
    this.dirty = false;
    this.drawn++;
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const titles = this.truthShown === 'beside' ? ['Truth', 'Chart'] : ['Chart'];
    if (titles.length !== this.view.titles.length) {
      this.view.titles = titles;
      this.stale = true;
      if (this.view.auto) this.fit();
    }
    this.#followUe();
    const axes = axisNames(this.pose, this.world.isRelative());
    this.stale ||= axes.join() !== this.axes?.join();
    this.axes = axes;
    const panes = this.view.panes(ratio);
    if (this.stale) {
      this.context.fillStyle = this.colours.plot;
      this.context.fillRect(0, 0, this.canvas.width, this.canvas.height);
      for (const pane of panes) {
        this.plan?.draw(this.context, pane);
        drawZones(this.context, pane, this.zones, this.colours, ratio);
        drawPane(this.context, { ...pane, title: titles.length > 1 ? pane.title : '' }, this.colours, ratio, this.pose, axes, !this.world.isRelative());
      }
      this.scatter.begin();
    }
    const { scatter, world } = this;
    if (this.stale || this.painted !== world.version) scatter.paint(world, this.colouring);
    this.painted = world.version;
    this.#settleTrails(panes);
    scatter.clear();
    const radius = ratio * this.#radius(panes[0], ratio);
    for (const pane of panes) {
      const [xs, ys] = this.#coordinates(pane);
      if (pane.title === 'Chart') {
        if (this.trails) scatter.heads(world, pane, TRAIL_ALPHA);
        if (this.truthShown === 'under') {
          scatter.links(world, pane, 70);
          scatter.points(world, world.true_x, world.true_y, pane, radius * 0.7, 90);
        }
      }
      scatter.points(world, xs, ys, pane, radius, 225);
    }
    scatter.show();
    this.#overlay(panes, ratio);
  }

  /** Keep the selected UE in the middle, where that is wished for. */
  #followUe() {
    const row = this.follow && this.ue !== null ? this.world.index.get(this.ue) : undefined;
    if (row === undefined || !Number.isFinite(this.world.px[row])) return;
    const centre = [this.world.px[row], this.world.py[row]];
    if (Math.hypot(centre[0] - this.view.centre[0], centre[1] - this.view.centre[1]) * this.view.scale < 0.5) return;
    this.view.auto = false;
    this.view.centre = centre;
    this.stale = true;
  }

  /** Trails grow once a second only: draw them into the ground now and then. */
  #settleTrails(panes) {
    const begin = performance.now();
    const due = begin - (this.settledAt ?? 0) > Math.max(TRAILS_EVERY_MS, (this.settleTook ?? 0) / TRAILS_SHARE);
    if (!this.stale && !(this.trails && due)) return;
    this.stale = false;
    const chart = panes.at(-1);
    this.scatter.settle(() => {
      if (this.trails) this.scatter.trails(this.world, chart, TRAIL_ALPHA);
    });
    this.settledAt = performance.now();
    this.settleTook = this.settledAt - begin;
  }

  /** CSS pixels: as large as the pane and the number of UEs allow. */
  #radius({ left, top, right, bottom }, ratio) {
    const room = Math.sqrt(((right - left) * (bottom - top)) / Math.max(this.world.rows, 1)) / ratio;
    return Math.min(Math.max(Math.round(room * 0.21 * 4) / 4, 1.25), 4.5);
  }

  #overlay(panes, ratio) {
    const context = this.over.getContext('2d');
    context.clearRect(0, 0, this.over.width, this.over.height);
    const selected = this.ue === null ? -1 : this.world.index.get(this.ue) ?? -1;
    for (const pane of panes) {
      context.save();
      context.beginPath();
      context.rect(pane.left, pane.top, pane.right - pane.left, pane.bottom - pane.top);
      context.clip();
      const [xs, ys] = this.#coordinates(pane);
      if (pane.title === 'Chart') {
        this.#velocities(context, pane, ratio);
        if (selected >= 0) this.#bearings(context, pane, ratio);
      }
      if (selected >= 0) this.#mark(context, pane, selected, xs, ys, ratio, true);
      if (this.hover >= 0 && this.hover !== selected && this.hover < this.world.rows) this.#mark(context, pane, this.hover, xs, ys, ratio, false);
      context.restore();
    }
  }

  #mark(context, pane, row, xs, ys, ratio, selected) {
    const { world, colours } = this;
    const x = pane.x0 + xs[row] * pane.scale;
    const y = pane.y0 - ys[row] * pane.scale;
    if (!Number.isFinite(x + y)) return;
    context.lineWidth = (selected ? 2 : 1.2) * ratio;
    context.strokeStyle = selected ? colours.accent : colours.text;
    if (selected && pane.title === 'Chart') {
      this.#spread(context, pane, row, x, y);
      const tx = pane.x0 + world.true_x[row] * pane.scale;
      const ty = pane.y0 - world.true_y[row] * pane.scale;
      if (Number.isFinite(tx + ty)) {
        context.beginPath();
        context.moveTo(x, y);
        context.lineTo(tx, ty);
        context.moveTo(tx - 4 * ratio, ty - 4 * ratio);
        context.lineTo(tx + 4 * ratio, ty + 4 * ratio);
        context.moveTo(tx - 4 * ratio, ty + 4 * ratio);
        context.lineTo(tx + 4 * ratio, ty - 4 * ratio);
        context.stroke();
      }
    }
    if (selected && pane.title === 'Chart') this.#past(context, pane, row);
    context.beginPath();
    context.arc(x, y, (selected ? 8 : 6) * ratio, 0, 2 * Math.PI);
    context.stroke();
    context.font = `600 ${font(ratio, 12)}`;
    const called = this.names?.of(world.ue[row]) ?? `${world.ue[row]}`;
    const text = selected ? called : `${called} · ${world.snr[row].toFixed(0)} dB`;
    const width = context.measureText(text).width + 10 * ratio;
    const left = x + 12 * ratio + width > pane.right ? x - 12 * ratio - width : x + 12 * ratio;
    context.fillStyle = colours.panel;
    context.globalAlpha = 0.88;
    context.fillRect(left, y - 10 * ratio, width, 20 * ratio);
    context.globalAlpha = 1;
    context.fillStyle = colours.text;
    context.textBaseline = 'middle';
    context.fillText(text, left + 5 * ratio, y);
  }

  /** Where UEs will be in a second, where they are tracked, as a line each. */
  #velocities(context, pane, ratio) {
    const { world, colours } = this;
    if (!this.trails || !world.present.has('vx') || world.rows > MOST_VELOCITIES) return;
    context.strokeStyle = colours.text;
    context.lineWidth = 1.2 * ratio;
    context.beginPath();
    for (let i = 0; i < world.rows; i++) {
      const [x, y] = [pane.x0 + world.px[i] * pane.scale, pane.y0 - world.py[i] * pane.scale];
      const [dx, dy] = [world.vx[i] * pane.scale, -world.vy[i] * pane.scale];
      if (!Number.isFinite(x + y + dx + dy) || Math.hypot(dx, dy) < 3 * ratio) continue;
      context.moveTo(x, y);
      context.lineTo(x + dx, y + dy);
    }
    context.stroke();
  }

  /** Where each array hears the selected UE from; fainter where that explains little of what it hears. */
  #bearings(context, pane, ratio) {
    context.lineWidth = 1.5 * ratio;
    context.strokeStyle = this.colours.accent;
    for (const { at, angle, share } of this.bearings ?? []) {
      const [x, y] = [pane.x0 + at[0] * pane.scale, pane.y0 - at[1] * pane.scale];
      context.globalAlpha = 0.25 + 0.6 * Math.min(Math.max(share, 0), 1);
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x + Math.cos(angle) * 4000 * ratio, y - Math.sin(angle) * 4000 * ratio);
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  /** Where the selected UE has been. */
  #past(context, pane, row) {
    const past = this.world.historyOf(row);
    context.beginPath();
    past.x.forEach((x, i) => context.lineTo(pane.x0 + x * pane.scale, pane.y0 - past.y[i] * pane.scale));
    context.stroke();
  }

  /** Two standard deviations, as an ellipse: of the covariance, or else of theta and rho, turned to the array. */
  #spread(context, pane, row, x, y) {
    const { world } = this;
    let along = 2 * world.rho_std[row] * pane.scale;
    let across = 2 * world.theta_std[row] * world.rho[row] * pane.scale;
    let turn = Math.atan2(y - pane.y0, x - pane.x0);
    const [xx, xy, yy] = ['x_var', 'xy_cov', 'y_var'].map((name) => world[name]?.[row] ?? NaN);
    if (Number.isFinite(xx + xy + yy)) {
      const middle = (xx + yy) / 2;
      const off = Math.hypot((xx - yy) / 2, xy);
      [along, across] = [middle + off, Math.max(middle - off, 0)].map((variance) => 2 * Math.sqrt(variance) * pane.scale);
      turn = -Math.atan2(2 * xy, xx - yy) / 2; // the picture's y axis points down
    }
    if (!(along > 0 && across > 0 && along < 1e4 && across < 1e4)) return;
    context.fillStyle = this.colours.band;
    context.beginPath();
    context.ellipse(x, y, along, across, turn, 0, 2 * Math.PI);
    context.fill();
  }
}
