// What part of the plane is seen: one or two panes with a common scale, moved by mouse, touch and keys.

const MARGIN = { left: 60, right: 12, top: 12, bottom: 40 };

export class View {
  /** `changed` is called when the transform moves, `picked(x, y, pointerType)` on a click, in CSS pixels. */
  constructor(element, { changed, picked, hovered }) {
    Object.assign(this, { element, changed, picked, hovered });
    this.centre = [0, 0];
    this.scale = 1; // CSS pixels a metre
    this.auto = true;
    this.across = true;
    this.titles = ['Chart'];
    this.pointers = new Map();
    this.#listen();
  }

  get size() {
    return [this.element.clientWidth, this.element.clientHeight];
  }

  /** The panes in CSS pixels, or in device pixels where `ratio` says so. */
  panes(ratio = 1) {
    return this.titles.map((title, i) => {
      const box = this.#box(i, this.across);
      const pane = { left: box.left * ratio, right: box.right * ratio, top: box.top * ratio, bottom: box.bottom * ratio };
      for (const side of ['left', 'right', 'top', 'bottom']) pane[side] = Math.round(pane[side]);
      pane.scale = this.scale * ratio;
      pane.x0 = (pane.left + pane.right) / 2 - this.centre[0] * pane.scale;
      pane.y0 = (pane.top + pane.bottom) / 2 + this.centre[1] * pane.scale;
      pane.title = title;
      pane.labelled = i === 0 || !this.across;
      return pane;
    });
  }

  /** The i-th pane beside or below the others; all are equally large. */
  #box(i, across) {
    const [width, height] = this.size;
    const n = this.titles.length;
    if (!across) {
      const each = height / n;
      return { left: MARGIN.left, right: width - MARGIN.right, top: each * i + MARGIN.top, bottom: each * (i + 1) - MARGIN.bottom };
    }
    const each = (width - MARGIN.left - n * MARGIN.right) / n;
    const left = MARGIN.left + i * (each + MARGIN.right);
    return { left, right: left + each, top: MARGIN.top, bottom: height - MARGIN.bottom };
  }

  /** Show the rectangle [x low, x high], [y low, y high] in metres. */
  fit([xLow, xHigh], [yLow, yHigh]) {
    const width = Math.max(xHigh - xLow, 1e-3) * 1.08;
    const height = Math.max(yHigh - yLow, 1e-3) * 1.08;
    const scaleOf = ({ left, right, top, bottom }) => Math.min((right - left) / width, (bottom - top) / height);
    const [beside, below] = [true, false].map((across) => scaleOf(this.#box(0, across)));
    if (!(Math.max(beside, below) > 0)) return;
    this.across = beside >= below;
    this.centre = [(xLow + xHigh) / 2, (yLow + yHigh) / 2];
    this.scale = Math.max(beside, below);
    this.changed();
  }

  pan(dx, dy) {
    this.auto = false;
    this.centre = [this.centre[0] - dx / this.scale, this.centre[1] + dy / this.scale];
    this.changed();
  }

  /** Zoom by `factor` about a point in CSS pixels (the middle of the first pane where none is given). */
  zoom(factor, x, y) {
    const pane = this.paneAt(x, y) ?? this.panes()[0];
    const px = x ?? (pane.left + pane.right) / 2;
    const py = y ?? (pane.top + pane.bottom) / 2;
    const scale = Math.min(Math.max(this.scale * factor, 1e-4), 1e4);
    const mx = (px - pane.x0) / pane.scale;
    const my = (pane.y0 - py) / pane.scale;
    this.auto = false;
    this.centre = [mx - (px - (pane.left + pane.right) / 2) / scale, my + (py - (pane.top + pane.bottom) / 2) / scale];
    this.scale = scale;
    this.changed();
  }

  paneAt(x, y) {
    return this.panes().find((p) => x >= p.left && x <= p.right && y >= p.top && y <= p.bottom);
  }

  #listen() {
    const { element, pointers } = this;
    const place = (event) => {
      const box = element.getBoundingClientRect();
      return [event.clientX - box.left - element.clientLeft, event.clientY - box.top - element.clientTop];
    };
    element.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), ...place(event));
    }, { passive: false });
    element.addEventListener('pointerdown', (event) => {
      element.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, place(event));
      this.moved = pointers.size > 1 ? Infinity : 0;
    });
    element.addEventListener('pointermove', (event) => {
      const to = place(event);
      const from = pointers.get(event.pointerId);
      if (!from) {
        this.hovered(...to);
        return;
      }
      if (pointers.size === 2) this.#pinch(event.pointerId, to);
      else if ((this.moved += Math.hypot(to[0] - from[0], to[1] - from[1])) > 4) {
        element.classList.add('drag');
        this.pan(to[0] - from[0], to[1] - from[1]);
      }
      pointers.set(event.pointerId, to);
    });
    const lift = (event) => {
      if (!pointers.delete(event.pointerId)) return;
      element.classList.remove('drag');
      if (event.type === 'pointerup' && this.moved <= 4) this.picked(...place(event), event.pointerType);
      if (pointers.size) this.moved = Infinity;
    };
    element.addEventListener('pointerup', lift);
    element.addEventListener('pointercancel', lift);
    element.addEventListener('pointerleave', () => this.hovered(NaN, NaN));
    element.addEventListener('dblclick', (event) => this.zoom(2, ...place(event)));
  }

  #pinch(id, to) {
    const from = this.pointers.get(id);
    const [, other] = [...this.pointers].find(([key]) => key !== id);
    const before = Math.hypot(from[0] - other[0], from[1] - other[1]);
    const after = Math.hypot(to[0] - other[0], to[1] - other[1]);
    this.pan((to[0] - from[0]) / 2, (to[1] - from[1]) / 2);
    if (before > 1) this.zoom(after / before, (to[0] + other[0]) / 2, (to[1] + other[1]) / 2);
  }
}
