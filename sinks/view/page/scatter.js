// Thousands of discs a frame without a GPU: written straight into pixels, shown with one putImageData.

import { HISTORY } from './world.js';

const TRAIL_POINTS = 24000; // of all UEs together
const TRAIL_MS = 60000; // a trail has faded away after so long of the data's time
const PHASES = 4; // sub-pixel positions a disc is prepared for, in each direction

/** Discs of `radius` pixels, one a sub-pixel phase: where their pixels are in an image so wide, and how covered. */
function discs(radius, width) {
  const reach = Math.ceil(radius + 1);
  const phases = Array.from({ length: PHASES * PHASES }, (_, phase) => {
    const places = [];
    const cover = [];
    for (let y = -reach; y <= reach; y++) {
      for (let x = -reach; x <= reach; x++) {
        const d = Math.hypot(x - (phase % PHASES) / PHASES, y - Math.floor(phase / PHASES) / PHASES);
        const alpha = Math.round(255 * Math.min(Math.max(radius + 0.5 - d, 0), 1));
        if (alpha) {
          places.push(y * width + x);
          cover.push(alpha);
        }
      }
    }
    return { places: Int32Array.from(places), cover: Uint8Array.from(cover) };
  });
  return { reach, phases };
}

const blend = (under, over, alpha) => {
  const rb = under & 0xff00ff;
  const g = under & 0x00ff00;
  const mixedRb = (rb + ((((over & 0xff00ff) - rb) * alpha) >> 8)) & 0xff00ff;
  const mixedG = (g + ((((over & 0x00ff00) - g) * alpha) >> 8)) & 0x00ff00;
  return 0xff000000 | mixedRb | mixedG;
};

export class Scatter {
  constructor(context) {
    this.context = context;
    this.prepared = new Map();
    this.colours = new Uint32Array(0);
  }

  /** Take what is on the canvas now (ground, grid, axes) as what lies below everything. */
  begin() {
    const { width, height } = this.context.canvas;
    this.plain = new Uint32Array(this.context.getImageData(0, 0, width, height).data.buffer);
    this.image = new ImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.ground = new Uint32Array(this.plain);
    this.prepared.clear();
  }

  /** Draw what changes seldom; it stays below the points from now on. */
  settle(draw) {
    this.pixels.set(this.plain);
    draw();
    this.ground.set(this.pixels);
  }

  clear() {
    this.pixels.set(this.ground);
  }

  show() {
    this.context.putImageData(this.image, 0, 0);
  }

  paint(world, colouring) {
    if (this.colours.length < world.rows) this.colours = new Uint32Array(world.capacity);
    colouring.paint(world, this.colours);
  }

  /** Discs at (xs, ys) metres in a pane; `alpha` of 256 is opaque. */
  points(world, xs, ys, pane, radius, alpha) {
    const { pixels, colours, prepared } = this;
    const { width } = this.image;
    if (!prepared.has(radius)) prepared.set(radius, discs(radius, width));
    const { reach, phases } = prepared.get(radius);
    const { left, top, right, bottom, scale, x0, y0 } = pane;
    for (let i = 0; i < world.rows; i++) {
      const px = x0 + xs[i] * scale;
      const py = y0 - ys[i] * scale;
      if (!(px >= left + reach && px < right - reach - 1 && py >= top + reach && py < bottom - reach - 1)) continue;
      const cx = Math.floor(px);
      const cy = Math.floor(py);
      const { places, cover } = phases[Math.floor((py - cy) * PHASES) * PHASES + Math.floor((px - cx) * PHASES)];
      const colour = colours[i];
      const centre = cy * width + cx;
      for (let m = 0; m < places.length; m++) {
        const at = centre + places[m];
        pixels[at] = blend(pixels[at], colour, (cover[m] * alpha) >> 8);
      }
    }
  }

  /** Where every UE has been, fading with age; the more UEs, the shorter. */
  trails(world, pane, weight) {
    const { traces } = world;
    const { x: xs, y: ys, time: times } = world.past;
    const { x0, y0, scale } = pane;
    const now = world.newest;
    const longest = Math.min(HISTORY, Math.max(4, Math.round(TRAIL_POINTS / world.rows)));
    for (let i = 0; i < world.rows; i++) {
      const count = Math.min(traces[i], longest);
      let at = i * HISTORY + ((traces[i] - 1) % HISTORY);
      for (let back = 1; back < count; back++) {
        const from = at > i * HISTORY ? at - 1 : at + HISTORY - 1;
        const alpha = Math.round(weight * (1 - back / (longest + 1)) * Math.max(0, 1 - (now - times[from]) / TRAIL_MS));
        if (!alpha) break;
        this.#line(pane, x0 + xs[at] * scale, y0 - ys[at] * scale, x0 + xs[from] * scale, y0 - ys[from] * scale, this.colours[i], alpha);
        at = from;
      }
    }
  }

  /** The newest piece of every trail, up to where the UE is drawn. */
  heads(world, pane, weight) {
    const { traces, px, py } = world;
    const { x: xs, y: ys } = world.past;
    const { x0, y0, scale } = pane;
    for (let i = 0; i < world.rows; i++) {
      if (!traces[i]) continue;
      const at = i * HISTORY + ((traces[i] - 1) % HISTORY);
      this.#line(pane, x0 + px[i] * scale, y0 - py[i] * scale, x0 + xs[at] * scale, y0 - ys[at] * scale, this.colours[i], weight);
    }
  }

  /** A line from every estimate to its truth. */
  links(world, pane, weight) {
    for (let i = 0; i < world.rows; i++) {
      const { x0, y0, scale } = pane;
      this.#line(pane, x0 + world.px[i] * scale, y0 - world.py[i] * scale,
        x0 + world.true_x[i] * scale, y0 - world.true_y[i] * scale, this.colours[i], weight);
    }
  }

  #line(pane, x1, y1, x2, y2, colour, alpha) {
    const long = Math.max(Math.abs(x2 - x1), Math.abs(y2 - y1));
    if (!(long >= 1 && long < 4000)) return;
    const steps = Math.ceil(long);
    const dx = (x2 - x1) / steps;
    const dy = (y2 - y1) / steps;
    const { pixels } = this;
    const { width } = this.image;
    for (let s = 0; s < steps; s++, x1 += dx, y1 += dy) {
      if (x1 >= pane.left && x1 < pane.right && y1 >= pane.top && y1 < pane.bottom) {
        const at = Math.floor(y1) * width + Math.floor(x1);
        pixels[at] = blend(pixels[at], colour, alpha);
      }
    }
  }
}
