// Looking back: a slider over the minutes that the node has kept.

const $ = (id) => document.getElementById(id);
const clock = (s) => (s < 60 ? `${Math.round(s)} s` : `${Math.floor(s / 60)} min ${Math.round(s % 60)} s`);

export class History {
  /** `changed` is called when the page begins or ends to look back. */
  constructor(stream, changed, toast) {
    Object.assign(this, { stream, changed, toast, ago: 0, kept: 0 });
    $('ago').addEventListener('input', () => this.#look(-Number($('ago').value)));
    $('now').addEventListener('click', () => this.#look(0));
  }

  get looking() {
    return this.ago > 0;
  }

  /** How many seconds the node has. */
  take(kept, hidden) {
    this.kept = kept;
    $('history').hidden = hidden || kept < 3;
    $('ago').min = -Math.floor(kept);
    if (!this.looking) $('ago').value = 0;
    this.#tell();
  }

  async #look(ago) {
    const was = this.looking;
    this.ago = Math.max(0, Math.min(ago, this.kept));
    this.#tell();
    if (was !== this.looking) this.changed();
    if (this.busy) return;
    this.busy = true;
    try {
      let shown = null;
      while (shown !== this.ago) {
        shown = this.ago;
        await this.stream.ask(...(shown > 0 ? ['past', { ago_s: shown }] : ['stream', { on: true }]));
      }
    } catch (error) {
      this.toast(`That time cannot be shown: ${error.message}`);
    } finally {
      this.busy = false;
    }
  }

  #tell() {
    const text = this.looking ? `${clock(this.ago)} ago` : 'now';
    $('agotext').textContent = text;
    $('ago').setAttribute('aria-valuetext', text);
    $('now').hidden = !this.looking;
    if (!this.looking) $('ago').value = 0;
  }
}
