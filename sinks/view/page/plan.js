// A floor plan or map under the chart, held by two points whose places are known.

import { locked } from './steering.js';

const $ = (id) => document.getElementById(id);
const PIECE = 9000; // bytes a message

export class Plan {
  /** `changed` is called when there is another picture to draw. */
  constructor(stream, changed, toast) {
    Object.assign(this, { stream, changed, toast, image: null, anchors: null, version: null, clicked: [] });
    $('planfile').addEventListener('change', () => $('planfile').files[0] && this.#send($('planfile').files[0]));
    $('planview').addEventListener('click', (event) => this.#click(event));
    $('planform').addEventListener('submit', (event) => {
      if (event.submitter?.value === 'keep') this.#keep(event);
    });
    for (const i of [0, 1]) {
      for (const [k, field] of [[0, 'c'], [1, 'r']]) $(`anchor${i}${field}`).addEventListener('change', () => this.#place(i, k, $(`anchor${i}${field}`).value));
    }
    $('planremove').addEventListener('click', () => this.#change({ remove: true }).then(() => $('plandialog').close()));
    const stage = $('plot');
    stage.addEventListener('dragover', (event) => event.preventDefault());
    stage.addEventListener('drop', (event) => {
      event.preventDefault();
      const [file] = event.dataTransfer.files;
      if (file && !locked()) this.show().then(() => this.#send(file));
    });
  }

  /** What the node keeps: {version, anchors}, or null. */
  async take(kept) {
    this.anchors = kept?.anchors ?? null;
    if (kept?.version !== this.version) {
      this.version = kept?.version ?? null;
      this.image = null;
      if (this.version) {
        const image = new Image();
        image.src = `plan?version=${this.version}`;
        await image.decode().then(() => (this.image = image)).catch(() => this.toast('The plan cannot be shown'));
      }
    }
    this.#preview();
    this.changed();
  }

  async show() {
    this.clicked = (this.anchors ?? []).map((anchor) => [...anchor]);
    $('plandialog').showModal();
    this.#fill();
    this.#preview();
  }

  async #change(request) {
    const { plan } = await this.stream.ask('plan', request);
    await this.take(plan);
  }

  async #send(file) {
    const bytes = new Uint8Array(await file.arrayBuffer());
    this.clicked = [];
    try {
      for (let at = 0; at < bytes.length; at += PIECE) {
        const piece = bytes.subarray(at, at + PIECE);
        const request = { at, data: btoa(String.fromCharCode(...piece)), last: at + PIECE >= bytes.length };
        $('planhint').textContent = `sending, ${Math.round((100 * at) / bytes.length)} %`;
        if (request.last) await this.#change(request);
        else await this.stream.ask('plan', request);
      }
      this.#fill();
    } catch (error) {
      $('planhint').textContent = error.message;
    }
  }

  #click(event) {
    if (!this.image) return;
    const box = $('planview').getBoundingClientRect();
    const scale = this.image.naturalWidth / box.width;
    if (this.clicked.length === 2) this.clicked = [];
    this.clicked.push([(event.clientX - box.left) * scale, (event.clientY - box.top) * scale, NaN, NaN]);
    this.#fill();
    this.#preview();
  }

  /** A point's column or row by hand, for whoever cannot click. */
  #place(i, k, value) {
    while (this.clicked.length <= i) this.clicked.push([NaN, NaN, NaN, NaN]);
    this.clicked[i][k] = value === '' ? NaN : Number(value);
    this.#fill();
    this.#preview();
  }

  #fill() {
    const placed = (i) => Number.isFinite(this.clicked[i]?.[0] + this.clicked[i]?.[1]);
    for (const i of [0, 1]) {
      for (const [k, axis] of [[0, 'c'], [1, 'r'], [2, 'x'], [3, 'y']]) {
        const field = $(`anchor${i}${axis}`);
        field.disabled = locked() || !this.image || (k > 1 && !placed(i));
        if (document.activeElement === field) continue;
        field.value = Number.isFinite(this.clicked[i]?.[k]) ? Math.round(this.clicked[i][k] * 100) / 100 : '';
      }
    }
    $('plankeep').disabled = locked() || !placed(0) || !placed(1);
    $('planhint').textContent = locked() ? $('planfile').title : !this.image ? 'PNG, JPEG or WebP; or drop a file on the chart.'
      : !placed(0) || !placed(1) ? `Click the ${placed(0) ? 'second' : 'first'} of two points whose places on the chart you know.` : 'Where are they on the chart, in metres?';
  }

  async #keep(event) {
    event.preventDefault();
    const anchors = this.clicked.map(([px, py], i) => [px, py, Number($(`anchor${i}x`).value), Number($(`anchor${i}y`).value)]);
    try {
      await this.#change({ anchors });
      $('plandialog').close();
    } catch (error) {
      $('planhint').textContent = error.message;
    }
  }

  #preview() {
    const canvas = $('planview');
    canvas.hidden = !this.image;
    if (!this.image) return;
    Object.assign(canvas, { width: this.image.naturalWidth, height: this.image.naturalHeight });
    const context = canvas.getContext('2d');
    context.drawImage(this.image, 0, 0);
    const size = Math.max(canvas.width, canvas.height) / 60;
    context.lineWidth = size / 3;
    context.font = `${2 * size}px sans-serif`;
    this.clicked.forEach(([x, y], i) => {
      context.strokeStyle = context.fillStyle = '#d00000';
      context.beginPath();
      context.arc(x, y, size, 0, 7);
      context.stroke();
      context.fillText(`${i + 1}`, x + 1.3 * size, y);
    });
  }

  /** Draw it into a pane, turned and scaled so that both anchors are in place. */
  draw(context, pane) {
    if (!this.image || !this.anchors) return;
    const [[px, py, x, y], [qx, qy, u, v]] = this.anchors;
    // Complex numbers: image w = px - i py (rows point down), chart z = x + i y; z = a w + b.
    const [wx, wy, zx, zy] = [qx - px, py - qy, u - x, v - y];
    const size = wx * wx + wy * wy;
    const [ar, ai] = [(zx * wx + zy * wy) / size, (zy * wx - zx * wy) / size];
    const s = pane.scale;
    context.save();
    context.beginPath();
    context.rect(pane.left, pane.top, pane.right - pane.left, pane.bottom - pane.top);
    context.clip();
    context.globalAlpha = 0.6;
    context.transform(ar * s, -ai * s, ai * s, ar * s, pane.x0 + (x - ar * px - ai * py) * s, pane.y0 - (y - ai * px + ar * py) * s);
    context.drawImage(this.image, 0, 0);
    context.restore();
  }
}
