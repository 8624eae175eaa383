// Thousands of discs a frame without a GPU: written straight into pixels, shown with one putImageData.

import { HISTORY } from './world.js';

const PHASES = 4; // sub-pixel positions a disc is prepared for, in each direction

/** Coverage masks of a disc of `radius` pixels, one for each sub-pixel phase. */
function discs(radius) {
  const reach = Math.ceil(radius + 1);
  const size = 2 * reach + 1;
  const masks = [];
  for (let fy = 0; fy < PHASES; fy++) {
    for (let fx = 0; fx < PHASES; fx++) {
      const mask = new Uint8Array(size * size);
      for (let y = 0; y < size; y++) {
        for (let x = 0; x < size; x++) {
          const d = Math.hypot(x - reach - fx / PHASES, y - reach - fy / PHASES);
          mask[y * size + x] = Math.round(255 * Math.min(Math.max(radius + 0.5 - d, 0), 1));
        }
      }
      masks.push(mask);
    }
  }
  return { reach, size, masks };
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

  /** Remember what is on the canvas now (ground, grid, axes) as the ground of the points. */
  begin() {
    const { width, height } = this.context.canvas;
    this.ground = new Uint32Array(this.context.getImageData(0, 0, width, height).data.buffer);
    this.image = new ImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
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
    const key = radius.toFixed(2);
    if (!this.prepared.has(key)) this.prepared.set(key, discs(radius));
    const { reach, size, masks } = this.prepared.get(key);
    const { pixels, colours } = this;
    const { width } = this.image;
    const { left, top, right, bottom, scale, x0, y0 } = pane;
    for (let i = 0; i < world.rows; i++) {
      const px = x0 + xs[i] * scale;
      const py = y0 - ys[i] * scale;
      if (!(px >= left + reach && px < right - reach - 1 && py >= top + reach && py < bottom - reach - 1)) continue;
      const cx = Math.floor(px);
      const cy = Math.floor(py);
      const mask = masks[Math.floor((py - cy) * PHASES) * PHASES + Math.floor((px - cx) * PHASES)];
      const colour = colours[i];
      let m = 0;
      for (let y = 0; y < size; y++) {
        let at = (cy - reach + y) * width + cx - reach;
        for (let x = 0; x < size; x++, at++, m++) {
          if (mask[m]) pixels[at] = blend(pixels[at], colour, (mask[m] * alpha) >> 8);
        }
      }
    }
  }

  /** Where every UE has been, fading with age. */
  trails(world, pane, weight) {
    const { past, traces } = world;
    for (let i = 0; i < world.rows; i++) {
      const count = Math.min(traces[i], HISTORY);
      let toX = pane.x0 + world.px[i] * pane.scale;
      let toY = pane.y0 - world.py[i] * pane.scale;
      for (let back = 1; back <= count; back++) {
        const at = i * HISTORY + ((traces[i] - back) % HISTORY);
        const x = pane.x0 + past.x[at] * pane.scale;
        const y = pane.y0 - past.y[at] * pane.scale;
        this.#line(pane, toX, toY, x, y, this.colours[i], Math.round(weight * (1 - back / (HISTORY + 1))));
        toX = x;
        toY = y;
      }
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
