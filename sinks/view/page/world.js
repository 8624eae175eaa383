// What the page knows of every UE: one row each in typed arrays, with a short history behind it.

export const HISTORY = 40; // samples a UE, at most one a second of the data's own time
const TRACED = ['x', 'y', 'theta', 'rho', 'snr'];

export class World {
  constructor() {
    this.columns = [];
    this.clear();
  }

  /** Which columns frames may have, as the node's hello tells: [{name, file_name, label, unit, decimals}]. */
  describe(columns) {
    if (JSON.stringify(columns) === JSON.stringify(this.columns)) return;
    this.columns = columns;
    this.clear();
  }

  clear() {
    this.numbers = this.columns.map(({ name }) => name).filter((name) => name !== 'ue' && name !== 'time_ns');
    this.present = new Set();
    this.rows = 0;
    this.capacity = 0;
    this.index = new Map();
    this.newest = 0;
    this.heard = performance.now();
    this.version = 0;
    this.#grow(1024);
  }

  /** Where the drawn points are; they glide towards the latest estimate. */
  #grow(capacity) {
    const wider = (Kind, old, width = 1) => {
      const array = new Kind(capacity * width);
      if (old) array.set(old);
      return array;
    };
    for (const name of this.numbers) this[name] = wider(Float64Array, this.rows && this[name]);
    for (const name of ['px', 'py']) this[name] = wider(Float32Array, this.rows && this[name]);
    this.ue = wider(BigUint64Array, this.rows && this.ue);
    this.time_ns = wider(BigInt64Array, this.rows && this.time_ns);
    this.time = wider(Float64Array, this.rows && this.time);
    this.epoch = wider(Uint32Array, this.rows && this.epoch);
    this.traces = wider(Uint32Array, this.rows && this.traces);
    this.past = this.past && this.rows ? this.past : {};
    for (const name of TRACED) this.past[name] = wider(Float32Array, this.rows && this.past[name], HISTORY);
    this.past.time = wider(Float64Array, this.rows && this.past.time, HISTORY);
    this.capacity = capacity;
  }

  /** Take a chart frame in. A full one is the whole truth: UEs it does not name are gone. */
  apply(frame) {
    this.version++;
    if (frame.full) {
      this.newest = 0;
      this.present.clear();
    }
    for (const [name] of frame.columns) this.present.add(name);
    const method = `${frame.method.theta}/${frame.method.rho}`;
    if (method !== this.method) this.traces.fill(0); // where another method saw them is no path
    this.method = method;
    const rows = Uint32Array.from(frame.ue, (ue) => this.#row(ue));
    for (const name of this.numbers) {
      const column = this[name];
      const values = frame[name];
      for (let i = 0; i < rows.length; i++) column[rows[i]] = values ? values[i] : NaN;
    }
    for (let i = 0; i < rows.length; i++) {
      const row = rows[i];
      this.time_ns[row] = frame.time_ns[i];
      this.time[row] = Number(frame.time_ns[i]) / 1e6;
      this.epoch[row] = this.version;
      if (Number.isNaN(this.px[row])) {
        this.px[row] = this.x[row];
        this.py[row] = this.y[row];
      }
      if (this.time[row] > this.newest) this.newest = this.time[row];
      this.#trace(row);
    }
    if (frame.full) this.#forget();
    this.heard = performance.now();
  }

  /** The row of a UE, a new one at the end where there is none. */
  #row(ue) {
    let row = this.index.get(ue);
    if (row === undefined) {
      if (this.rows === this.capacity) this.#grow(this.capacity * 2);
      row = this.rows++;
      this.index.set(ue, row);
      this.ue[row] = ue;
      this.traces[row] = 0;
      this.px[row] = NaN; // not drawn yet
    }
    return row;
  }

  #trace(row) {
    const { past } = this;
    const base = row * HISTORY;
    let count = this.traces[row];
    const since = count ? this.time[row] - past.time[base + ((count - 1) % HISTORY)] : Infinity;
    if (since >= 0 && since < 1000) return;
    if (since < 0) count = 0; // a replay has begun anew
    const at = base + (count % HISTORY);
    for (const name of TRACED) past[name][at] = this[name][row];
    past.time[at] = this.time[row];
    this.traces[row] = count + 1;
  }

  #forget() {
    for (let row = this.rows - 1; row >= 0; row--) {
      if (this.epoch[row] === this.version) continue;
      this.index.delete(this.ue[row]);
      const last = --this.rows;
      if (row === last) continue;
      for (const name of [...this.numbers, 'px', 'py', 'ue', 'time', 'time_ns', 'epoch', 'traces']) this[name][row] = this[name][last];
      for (const column of Object.values(this.past)) {
        column.copyWithin(row * HISTORY, last * HISTORY, (last + 1) * HISTORY);
      }
      this.index.set(this.ue[row], row);
    }
  }

  /** Let drawn points glide towards their estimates; says whether any still moves. */
  glide(fraction, tolerance) {
    let moving = false;
    const { px, py, x, y } = this;
    for (let i = 0; i < this.rows; i++) {
      const dx = x[i] - px[i];
      const dy = y[i] - py[i];
      if (Math.abs(dx) > tolerance || Math.abs(dy) > tolerance) {
        px[i] += dx * fraction;
        py[i] += dy * fraction;
        moving = true;
      }
    }
    return moving;
  }

  /** The data's own clock, in ms since the epoch. */
  now() {
    return this.newest + (performance.now() - this.heard);
  }

  /** Of how many UEs the true position is known, as a share. */
  knownShare() {
    const step = Math.max(1, Math.floor(this.rows / 4000));
    let known = 0;
    for (let i = 0; i < this.rows; i += step) known += Number.isFinite(this.true_x[i]);
    return this.rows ? (known * step) / this.rows : 0;
  }

  /** Whether the distances of some UEs have no scale. */
  isRelative() {
    return Boolean(this.relative?.subarray(0, this.rows).some((value) => value > 0));
  }

  /** Distance between estimate and truth in metres; NaN where the truth is unknown. */
  error(row) {
    return Math.hypot(this.x[row] - this.true_x[row], this.y[row] - this.true_y[row]);
  }

  /** A UE's past, oldest first: {time, x, y, theta, rho, snr} arrays. */
  historyOf(row) {
    const count = this.traces[row];
    const n = Math.min(count, HISTORY);
    const places = Array.from({ length: n }, (_, i) => row * HISTORY + ((count - n + i) % HISTORY));
    return Object.fromEntries(Object.entries(this.past).map(([name, column]) => [name, places.map((p) => column[p])]));
  }

  /** [low, high] that most values of a column lie in, outliers left out; null where there are none. */
  spread(column, low = 0.005, high = 0.995) {
    const step = Math.max(1, Math.floor(this.rows / 4000));
    const values = [];
    for (let i = 0; i < this.rows; i += step) if (Number.isFinite(column[i])) values.push(column[i]);
    if (!values.length) return null;
    values.sort((a, b) => a - b);
    const at = (q) => values[Math.round(q * (values.length - 1))];
    return [at(low), at(high)];
  }
}
