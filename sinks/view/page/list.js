// All UEs as a table that can be sorted and filtered.

import { number } from './panels.js';

const $ = (id) => document.getElementById(id);
const MOST = 500; // rows shown at once

export class List {
  constructor(world, names, select) {
    Object.assign(this, { world, names, select, by: 'ue', down: false });
    $('filter').addEventListener('input', () => this.fill());
    $('list').addEventListener('close', () => clearInterval(this.timer));
    $('listtable').tBodies[0].addEventListener('click', ({ target }) => this.#choose(target.closest('tr')));
    $('listtable').tBodies[0].addEventListener('keydown', (event) => {
      if (event.key === 'Enter') this.#choose(event.target.closest('tr'));
    });
  }

  show() {
    $('list').showModal();
    this.fill();
    this.timer = setInterval(() => this.fill(), 2000);
  }

  #choose(row) {
    if (!row) return;
    $('list').close();
    this.select(BigInt(row.dataset.ue));
  }

  /** Which columns there are, and how each value reads: [name, heading, text of a row, number of a row]. */
  #columns() {
    const { world, names } = this;
    const degrees = 180 / Math.PI;
    const shown = world.columns.filter(({ name }) => world.present.has(name) && name !== 'ue' && name !== 'time_ns' && !name.startsWith('position_'));
    return [
      ['ue', 'UE', (row) => names.of(world.ue[row]), null],
      ...shown.map(({ name, label, unit, decimals }) => {
        const scale = unit === 'rad' ? degrees : 1;
        const value = (row) => world[name][row] * scale;
        const digits = unit === 'rad' ? Math.max(0, decimals - 4) : Math.min(decimals, 2);
        const heading = name.startsWith('true_') ? `true ${name.at(-1)}` : label;
        return [name, `${heading} ${unit === 'rad' ? '°' : unit}`.trim(), (row) => (Number.isFinite(value(row)) ? value(row).toFixed(digits).replace('-', '−') : '–'), value];
      }),
      ['age', 'heard, s ago', (row) => number((world.now() - world.time[row]) / 1000), (row) => world.now() - world.time[row]],
      ['error', 'error m', (row) => number(world.error(row)), (row) => world.error(row)],
    ];
  }

  /** `snr>10`, `x<50` or part of a name or number, any number of them. */
  #wanted(columns) {
    return $('filter').value.trim().split(/\s+/).filter(Boolean).map((word) => {
      const [, name, sign, limit] = /^([a-z_]+)([<>])(-?[\d.]+)$/i.exec(word) ?? [];
      const column = columns.find((one) => one[0] === name && one[3]);
      if (column) return (row) => (sign === '<' ? column[3](row) < Number(limit) : column[3](row) > Number(limit));
      return (row) => columns[0][2](row).toLowerCase().includes(word.toLowerCase()) || `${this.world.ue[row]}`.includes(word);
    });
  }

  fill() {
    const { world } = this;
    const columns = this.#columns();
    const wanted = this.#wanted(columns);
    const rows = Array.from({ length: world.rows }, (_, row) => row).filter((row) => wanted.every((fits) => fits(row)));
    const column = columns.find(([name]) => name === this.by) ?? columns[0];
    const value = column[3];
    const text = (row) => column[2](row);
    rows.sort((a, b) => (value ? value(a) - value(b) || 0 : text(a).localeCompare(text(b), undefined, { numeric: true })));
    if (value) rows.sort((a, b) => Number.isNaN(value(a)) - Number.isNaN(value(b)));
    if (this.down) rows.reverse();
    $('listcount').textContent = `${number(rows.length)} of ${number(world.rows)} UEs${rows.length > MOST ? `, the first ${MOST} shown` : ''}`;
    $('listtable').tHead.rows[0].replaceChildren(...columns.map(([name, heading]) => {
      const cell = document.createElement('th');
      cell.setAttribute('aria-sort', name === this.by ? (this.down ? 'descending' : 'ascending') : 'none');
      const button = Object.assign(document.createElement('button'), { type: 'button', textContent: `${heading}${name === this.by ? (this.down ? ' ▾' : ' ▴') : ''}` });
      button.dataset.by = name;
      button.addEventListener('click', () => {
        this.down = this.by === name && !this.down;
        this.by = name;
        this.fill();
        $('listtable').querySelector(`button[data-by="${name}"]`)?.focus();
      });
      cell.append(button);
      return cell;
    }));
    const focused = document.activeElement?.dataset?.ue;
    $('listtable').tBodies[0].replaceChildren(...rows.slice(0, MOST).map((row) => {
      const line = document.createElement('tr');
      line.dataset.ue = `${world.ue[row]}`;
      line.tabIndex = 0;
      for (const [, , say] of columns) line.insertCell().textContent = say(row);
      return line;
    }));
    if (focused) $('listtable').querySelector(`tr[data-ue="${focused}"]`)?.focus();
  }
}
