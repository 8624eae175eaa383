// A recording that is played: play, pause, pace, and a time line that shows where its frames are.

import { themeColours } from './axes.js';
import { locked } from './steering.js';

const $ = (id) => document.getElementById(id);
const clock = (s) => `${Math.floor(s / 60)}:${`${Math.floor(s % 60)}`.padStart(2, '0')}`;

export class Replay {
  /** `jumped` is called when the chart begins anew, `toast` with what went wrong. */
  constructor(stream, jumped, toast) {
    Object.assign(this, { stream, jumped, toast, plays: null, density: null });
    $('play').addEventListener('click', () => this.toggle());
    $('speed').addEventListener('change', () => this.#wish({ speed: Number($('speed').value) }));
    $('seek').addEventListener('input', () => this.#tell(Number($('seek').value)));
    $('seek').addEventListener('change', () => this.#wish({ at_s: Number($('seek').value) }));
    new ResizeObserver(() => this.#draw()).observe($('density'));
  }

  get shown() {
    return this.plays !== null;
  }

  /** What the status says of the source. */
  take(plays) {
    const first = this.plays === null && plays;
    this.plays = plays ?? null;
    $('replay').hidden = !plays;
    $('pause').hidden = Boolean(plays);
    if (!plays) return;
    $('play').textContent = plays.ended ? '↺' : plays.paused ? '▶' : '❚❚';
    $('play').setAttribute('aria-label', plays.ended ? 'Play again' : plays.paused ? 'Play' : 'Pause');
    if (document.activeElement !== $('speed')) {
      if (![...$('speed').options].some((o) => Number(o.value) === plays.speed)) $('speed').add(new Option(`${plays.speed} ×`, plays.speed));
      $('speed').value = `${plays.speed}`;
    }
    $('seek').max = plays.length_s;
    if (!this.dragging) {
      $('seek').value = plays.at_s;
      this.#tell(plays.at_s);
    }
    if (first) this.#wish({});
  }

  toggle() {
    if (locked()) return;
    this.#wish({ paused: this.plays?.ended ? false : !this.plays?.paused });
  }

  async #wish(wishes) {
    this.dragging = false;
    try {
      const answer = await this.stream.ask('replay', wishes);
      this.density = answer.density;
      if (answer.jumped) this.jumped();
      this.take(answer);
      this.#draw();
    } catch (error) {
      this.toast(`The recording plays on: ${error.message}`);
    }
  }

  #tell(at) {
    this.dragging = document.activeElement === $('seek') && at !== this.plays.at_s;
    const { length_s: length, start_ns: start, ended } = this.plays;
    const day = start ? ` · ${new Date(start / 1e6 + at * 1000).toISOString().slice(0, 19).replace('T', ' ')} UTC` : '';
    $('at').textContent = `${clock(at)} / ${clock(length)}${ended ? ' · end' : ''}${day}`;
    $('seek').setAttribute('aria-valuetext', `${clock(at)} of ${clock(length)}`);
  }

  #draw() {
    const canvas = $('density');
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (!this.density || !width) return;
    Object.assign(canvas, { width, height });
    const context = canvas.getContext('2d');
    context.fillStyle = themeColours().band;
    const most = Math.max(...this.density, 1e-9);
    const step = width / this.density.length;
    this.density.forEach((share, i) => {
      const tall = share > 0 ? Math.max(2 * ratio, (share / most) * height) : 0;
      context.fillRect(Math.floor(i * step), height - tall, Math.ceil(step), tall);
    });
  }
}
