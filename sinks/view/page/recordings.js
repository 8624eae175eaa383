// Recordings: what is being recorded, and what is in the node's folder.

import { stamp } from './export.js';
import { number } from './panels.js';

const $ = (id) => document.getElementById(id);

/** Bytes for people. */
export function bytes(n) {
  const step = Math.min(4, Math.max(0, Math.floor(Math.log10(Math.max(n, 1)) / 3)));
  return `${number(n / 1000 ** step)} ${['B', 'kB', 'MB', 'GB', 'TB'][step]}`;
}

const time = (s) => `${Math.floor(s / 60)}:${`${Math.floor(s % 60)}`.padStart(2, '0')}`;

export class Recordings {
  constructor(stream, toast) {
    Object.assign(this, { stream, toast, since: null, before: null });
    $('recording').addEventListener('close', () => this.#start());
  }

  /** Close what is being recorded, or ask for the name of a new file. */
  async startOrStop() {
    if ($('record').disabled) return;
    if ($('record').getAttribute('aria-pressed') === 'true') {
      try {
        await this.stream.ask('record', { on: false });
        this.toast('Recording closed');
      } catch (error) {
        this.toast(`Recording goes on: ${error.message}`);
      }
      return;
    }
    $('file').value = `capture-${stamp()}.mcap`;
    $('recording').returnValue = '';
    this.show().catch((error) => ($('recordingsin').textContent = error.message));
    $('recording').showModal();
  }

  async #start() {
    if ($('recording').returnValue !== 'start') return;
    try {
      await this.stream.ask('record', { on: true, path: $('file').value, compression: $('zstd').checked ? 'zstd' : 'none' });
      this.toast(`Recording to ${$('file').value}`);
    } catch (error) {
      this.toast(`Not recording: ${error.message}`);
    }
  }

  /** What is recorded at the moment, from a status; null where nothing is. */
  take(recording) {
    if (!recording) {
      this.since = this.before = null;
      $('recorded').textContent = '';
      return;
    }
    this.since ??= performance.now();
    this.#measure(recording.split('/').at(-1));
  }

  async #measure(name) {
    if (this.asking) return;
    this.asking = true;
    try {
      const { recordings, free_bytes: free } = await this.stream.ask('recordings');
      const file = recordings.find((one) => one.name === name);
      const now = performance.now();
      if (!file || this.since === null) return;
      const rate = this.before ? (file.size - this.before.size) / Math.max((now - this.before.at) / 1000, 0.1) : 0;
      if (!this.before || now - this.before.at > 4000) this.before = { size: file.size, at: now };
      $('recorded').textContent = `${time((now - this.since) / 1000)} · ${bytes(file.size)} · ${bytes(rate)}/s · ${bytes(free)} free`;
    } catch {
      $('recorded').textContent = '';
    } finally {
      this.asking = false;
    }
  }

  /** Fill the table of the dialog. */
  async show() {
    const body = $('recordings').tBodies[0];
    body.replaceChildren();
    const { folder, free_bytes: free, recordings } = await this.stream.ask('recordings');
    $('recordingsin').textContent = `${folder}: ${recordings.length || 'no'} recordings, ${bytes(free)} free. chachart-node FILE plays one.`;
    body.replaceChildren(...recordings.map((one) => {
      const row = document.createElement('tr');
      const link = Object.assign(document.createElement('a'), { href: `recordings?name=${encodeURIComponent(one.name)}`, textContent: one.name, download: one.name });
      row.insertCell().append(link);
      for (const text of [bytes(one.size), time(one.seconds), one.frames === null ? '…' : number(one.frames), one.ues === null ? '…' : number(one.ues), `${one.array} ${one.antennas} × ${one.subcarriers}`]) {
        row.insertCell().textContent = text;
      }
      return row;
    }));
    $('recordings').hidden = !recordings.length;
  }
}
