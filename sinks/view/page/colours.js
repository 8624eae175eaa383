// Palettes that survive colour blindness: viridis for one quantity, blue to orange by light to dark for two.

const VIRIDIS = ['#440154', '#482878', '#3e4a89', '#31688e', '#26838f', '#1f9e89', '#35b779', '#6dcd59', '#b4de2c', '#fde725'];
// Corners of the position palette: [near, far] for one end of the axis, its middle and its other end.
const POSITION = { near: ['#2743c9', '#a8328f', '#c04a00'], far: ['#7fc4ff', '#f39ac7', '#ffd257'] };
const STEPS = 64;

const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
const gamma = (v) => (v <= 0.0031308 ? v * 12.92 : 1.055 * v ** (1 / 2.4) - 0.055);
const hex = (s) => [1, 3, 5].map((i) => linear(parseInt(s.slice(i, i + 2), 16) / 255));
const mix = (a, b, t) => a.map((v, i) => v + (b[i] - v) * t);
const along = (stops, t) => {
  const at = Math.min(Math.max(t, 0), 1) * (stops.length - 1);
  const i = Math.min(Math.floor(at), stops.length - 2);
  return mix(stops[i], stops[i + 1], at - i);
};
const pack = (rgb) => {
  const [r, g, b] = rgb.map((v) => Math.round(255 * gamma(Math.min(Math.max(v, 0), 1))));
  return ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
};

const near = POSITION.near.map(hex);
const far = POSITION.far.map(hex);
const viridis = VIRIDIS.map(hex);

/** 256 packed ABGR colours; the end that would drown in the background is left out. */
export function scalarTable(dark) {
  const [from, to] = dark ? [0.22, 1] : [0, 0.9];
  return Uint32Array.from({ length: 256 }, (_, i) => pack(along(viridis, from + ((to - from) * i) / 255)));
}

/** STEPS x STEPS packed colours: row by distance from the array, column by place along its axis. */
export function positionTable(dark) {
  const [from, to] = dark ? [0.3, 1] : [0, 0.75];
  const table = new Uint32Array(STEPS * STEPS);
  for (let v = 0; v < STEPS; v++) {
    const depth = from + ((to - from) * v) / (STEPS - 1);
    for (let u = 0; u < STEPS; u++) {
      const t = u / (STEPS - 1);
      table[v * STEPS + u] = pack(mix(along(near, t), along(far, t), depth));
    }
  }
  return table;
}

/** CSS form of a packed colour. */
export const css = (abgr) => `rgb(${abgr & 255} ${(abgr >> 8) & 255} ${(abgr >> 16) & 255})`;

const clamp = (v) => (v < 0 ? 0 : v > 1 ? 1 : v);

/** What the points are coloured by. `paint(world, out)` fills one packed colour a row. */
export class Colouring {
  constructor() {
    this.by = 'truth';
    this.setTheme(true);
  }

  setTheme(dark) {
    this.scalar = scalarTable(dark);
    this.position = positionTable(dark);
    this.unknown = dark ? 0xff8c7f74 : 0xffa69a90;
  }

  /** Positions need a truth: without one SNR takes their place. */
  effective(world) {
    if ((this.by === 'truth' || this.by === 'error') && !world.spread(world.true_x)) return 'snr';
    return this.by;
  }

  /** Numbers behind the colours, and what the key says about them. */
  measure(world) {
    const by = this.effective(world);
    if (by === 'truth') {
      this.ranges = [world.spread(world.true_y, 0.01, 0.99), world.spread(world.true_x, 0.01, 0.99)];
      const [low, high] = this.ranges[0].map((v) => v.toFixed(0).replace('-', '−'));
      return { by, low: `y ${low} m`, high: `${high} m; lighter is farther` };
    }
    if (by === 'age') {
      const ages = Float32Array.from({ length: world.rows }, (_, i) => (world.now() - world.time[i]) / 1000);
      this.range = [0, Math.max(1, world.spread(ages)?.[1] ?? 1)];
      return { by, low: '0 s', high: `${this.range[1].toFixed(1)} s since last heard` };
    }
    if (by === 'error') {
      const errors = Float32Array.from({ length: world.rows }, (_, i) => world.error(i));
      this.range = [0, Math.max(0.01, world.spread(errors, 0, 0.98)?.[1] ?? 1)];
      return { by, low: '0 m', high: `${this.range[1].toPrecision(2)} m off` };
    }
    const [column, unit] = by === 'range' ? [world.rho, world.isRelative() ? 'of an unknown scale,' : 'm'] : [world.snr, 'dB'];
    this.range = world.spread(column, 0.02, 0.98) ?? [0, 1];
    return { by, low: this.range[0].toFixed(0), high: `${this.range[1].toFixed(0)} ${unit} ${by === 'snr' ? 'SNR' : 'range'}` };
  }

  paint(world, out) {
    const by = this.effective(world);
    if (by === 'truth') return this.#paintPosition(world, out);
    const [low, high] = this.range ?? [0, 1];
    const now = world.now();
    const value = {
      snr: (i) => world.snr[i],
      range: (i) => world.rho[i],
      error: (i) => world.error(i),
      age: (i) => (now - world.time[i]) / 1000,
    }[by];
    const scale = 255 / (high - low || 1);
    for (let i = 0; i < world.rows; i++) {
      const v = value(i);
      out[i] = Number.isNaN(v) ? this.unknown : this.scalar[Math.round(Math.min(Math.max((v - low) * scale, 0), 255))];
    }
  }

  #paintPosition(world, out) {
    const [[uLow, uHigh], [vLow, vHigh]] = this.ranges ?? [[0, 1], [0, 1]];
    const uScale = 1 / (uHigh - uLow || 1);
    const vScale = 1 / (vHigh - vLow || 1);
    for (let i = 0; i < world.rows; i++) {
      const u = (world.true_y[i] - uLow) * uScale;
      const v = (world.true_x[i] - vLow) * vScale;
      out[i] = Number.isNaN(u) ? this.unknown
        : this.position[Math.round(clamp(v) * (STEPS - 1)) * STEPS + Math.round(clamp(u) * (STEPS - 1))];
    }
  }

  /** Paint the colour key. */
  key(canvas, by) {
    const context = canvas.getContext('2d');
    const { width, height } = canvas;
    for (let x = 0; x < width; x++) {
      if (by === 'truth') {
        const u = Math.round((x / (width - 1)) * (STEPS - 1));
        for (let y = 0; y < height; y++) {
          const v = Math.round((1 - y / (height - 1)) * (STEPS - 1));
          context.fillStyle = css(this.position[v * STEPS + u]);
          context.fillRect(x, y, 1, 1);
        }
      } else {
        context.fillStyle = css(this.scalar[Math.round((x / (width - 1)) * 255)]);
        context.fillRect(x, 0, 1, height);
      }
    }
  }
}
