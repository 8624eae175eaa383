// The connection to the node: comes back by itself, decodes chart frames, matches answers to questions.

const COLUMNS = { u8: [BigUint64Array, 8], i8: [BigInt64Array, 8], f4: [Float32Array, 4], u4: [Uint32Array, 4], i4: [Int32Array, 4] };
const SILENCE_MS = 6000; // the node says something at least every second
const ANSWER_MS = 10000;

/** A chart frame: uint32 header length, JSON header padded to 8 bytes, then the columns it names. */
export function decodeFrame(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = Math.ceil((4 + length) / 8) * 8;
  for (const [name, kind] of header.columns) {
    const [Column, bytes] = COLUMNS[kind];
    header[name] = new Column(buffer, at, header.rows);
    at += header.rows * bytes;
  }
  return header;
}

export class Stream extends EventTarget {
  constructor() {
    super();
    this.state = 'connecting';
    this.asked = new Map();
    this.lastId = 0;
    this.attempts = 0;
    this.paused = false;
    setInterval(() => this.#watch(), 1000);
    this.#connect();
  }

  /** Ask for an operation; resolves to its result, rejects with the node's own words. */
  ask(op, args = {}) {
    if (this.socket.readyState !== WebSocket.OPEN) return Promise.reject(new Error('the node is gone'));
    const id = ++this.lastId;
    this.socket.send(JSON.stringify({ ...args, id, op }));
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => this.#settle(id, { error: 'the node does not answer' }), ANSWER_MS);
      this.asked.set(id, { resolve, reject, timer });
    });
  }

  /** Stop or resume the flow of charts; resuming brings the whole chart anew. */
  pause(on) {
    this.paused = on;
    if (this.socket.readyState === WebSocket.OPEN) this.ask('stream', { on: !on }).catch(() => {});
    this.#become(this.state === 'gone' || this.state === 'connecting' ? this.state : on ? 'paused' : 'live');
  }

  #connect() {
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    socket.binaryType = 'arraybuffer';
    socket.onmessage = ({ data }) => this.#take(data);
    socket.onopen = () => {
      this.attempts = 0;
      this.heard = performance.now();
      this.#become(this.paused ? 'paused' : 'live');
      if (this.paused || document.hidden) this.ask('stream', { on: false }).catch(() => {});
    };
    socket.onclose = ({ code, reason }) => {
      for (const id of [...this.asked.keys()]) this.#settle(id, { error: 'the node is gone' });
      this.reason = code === 1013 ? reason : '';
      this.#become('gone');
      const wait = Math.min(500 * 1.6 ** this.attempts++, 5000) * (0.8 + 0.4 * Math.random());
      setTimeout(() => this.#connect(), wait);
    };
    this.socket = socket;
    this.heard = performance.now();
  }

  #watch() {
    if (this.socket.readyState === WebSocket.OPEN && performance.now() - this.heard > SILENCE_MS) this.socket.close();
  }

  #take(data) {
    this.heard = performance.now();
    const message = typeof data === 'string' ? JSON.parse(data) : decodeFrame(data);
    if (message.type === 'answer') this.#settle(message.id, message);
    else this.dispatchEvent(new CustomEvent(message.type, { detail: message }));
  }

  #settle(id, { result, error }) {
    const asked = this.asked.get(id);
    if (!asked) return;
    this.asked.delete(id);
    clearTimeout(asked.timer);
    if (error === undefined) asked.resolve(result);
    else asked.reject(new Error(error));
  }

  #become(state) {
    if (state === this.state) return;
    this.state = state;
    this.dispatchEvent(new Event('state'));
  }
}
