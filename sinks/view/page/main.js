// Ties the stream, the chart, the panels and the controls together.

import { showAlerts } from './alerts.js';
import { showAntennas, showResponse } from './antennas.js';
import { showArrays, showBearings } from './arrays.js';
import { redraw } from './curve.js';
import { showPaths, strongPaths, Waterfall } from './depth.js';
import { saveCsv, saveDrawing, savePng } from './export.js';
import { History } from './history.js';
import { bindKeys } from './keys.js';
import { List } from './list.js';
import { Names } from './names.js';
import { number, showHistory, showNode, showQuality, showQualityAgainstK, showQualityOverTime, showSpectra, showUser } from './panels.js';
import { Picture } from './picture.js';
import { showState } from './pill.js';
import { Plan } from './plan.js';
import { Recordings } from './recordings.js';
import { Replay } from './replay.js';
import { changeMethod, lock } from './steering.js';
import { Stream } from './stream.js';
import { World } from './world.js';

const KEPT = 720; // reports behind the curves
const $ = (id) => document.getElementById(id);
const world = new World();
const picture = new Picture($('plot'), world, (row) => select(row < 0 ? null : world.ue[row]));
const stream = new Stream();
const names = new Names();
picture.names = names;
const waterfall = new Waterfall();
const list = new List(world, names, (ue) => select(ue));
const history = new History(stream, () => pill(), toast);
const plan = new Plan(stream, () => picture.touch(true), toast);
picture.plan = plan;
const recordings = new Recordings(stream, toast);
const replay = new Replay(stream, () => {
  world.clear();
  stream.ask('sync').catch(() => {});
}, toast);
let hello = null;
let statuses = [];
let qualities = [];
let excess = 0;

const say = (text) => ($('said').textContent = text);
function toast(text) {
  $('toast').textContent = text;
  $('toast').hidden = false;
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => ($('toast').hidden = true), 5000);
}

// ---- theme -----------------------------------------------------------------------------------------------
const system = matchMedia('(prefers-color-scheme: dark)');
function theme(choice) {
  if (choice) localStorage.setItem('theme', choice);
  const dark = (localStorage.getItem('theme') ?? (system.matches ? 'dark' : 'light')) === 'dark';
  document.documentElement.dataset.theme = dark ? 'dark' : 'light';
  picture.retheme(dark);
  key();
  redraw(document.querySelectorAll('.curve'));
}
system.addEventListener('change', () => theme());

// ---- what the node says ----------------------------------------------------------------------------------
stream.addEventListener('state', () => {
  pill();
  const over = ended();
  $('gone').hidden = stream.state !== 'gone';
  $('gone').classList.toggle('calm', over);
  const why = over ? 'The node has ended, as it should.' : stream.reason || 'The node is gone.';
  if (stream.state === 'gone') $('gone').textContent = `${why} This is the last chart it gave; trying to reach it again …`;
  lock(stream.state === 'gone', hello?.may_steer);
});

/** Whether the node said that it was about to end before it went. */
const ended = () => stream.state === 'gone' && ['draining', 'stopped'].includes(statuses.at(-1)?.state);

function pill() {
  const play = stream.state === 'live' ? replay.plays : null;
  showState(stream.state === 'gone' && ended() ? 'ended' : stream.state, statuses.at(-1), play, stream.state === 'live' && history.looking);
}

stream.addEventListener('hello', ({ detail }) => {
  if (hello && hello.page !== detail.page) location.reload();
  hello = detail;
  lock(false, hello.may_steer);
  world.describe(hello.columns);
  names.take(hello.names);
  plan.take(hello.plan);
  picture.pose = { ...hello.pose, heading_deg: hello.heading_deg };
  picture.bearings = [];
  const { array } = hello;
  $('array').textContent = `${array.name} · ${array.antennas} antennas · ${array.subcarriers} subcarriers · ${number(array.carrier_hz / 1e9)} GHz`;
  document.title = `${array.name} · chachart`;
  for (const kind of ['theta', 'rho']) {
    $(kind).replaceChildren(...hello.methods[kind].map((name) => new Option(name, name)));
  }
  statuses = hello.statuses;
  qualities = hello.qualities;
  takeQuality();
  if (statuses.length) takeStatus(statuses.at(-1));
});

stream.addEventListener('chart', ({ detail: frame }) => {
  const first = world.rows === 0;
  world.apply(frame);
  if (fused() && !picture.pose.world) {
    picture.pose.world = true;
    picture.touch(true);
  }
  if (first) takeQuality();
  $('waiting').hidden = world.rows > 0;
  for (const kind of ['theta', 'rho']) if (document.activeElement !== $(kind)) $(kind).value = frame.method[kind];
  if (first && world.rows) measure();
  picture.touch();
});

/** Whether positions are fused from several arrays or tracked: then there is one method, and the chart is the world's. */
const fused = () => world.method === 'fusion/fusion';

stream.addEventListener('status', ({ detail }) => {
  statuses = [...statuses, detail].slice(-KEPT);
  takeStatus(detail);
});

function takeStatus(status) {
  showNode(status, statuses);
  showArrays(status);
  showAlerts(status.alerts, toast);
  picture.enclose(status.alerts.zones);
  $('method').hidden = fused();
  replay.take(status.source_details?.replay);
  history.take(status.history_s ?? 0, replay.shown);
  recordings.take(status.recording);
  showAntennas(status.antennas, hello.array, hello.places);
  pill();
  const on = Boolean(status.recording);
  $('record').setAttribute('aria-pressed', on);
  // UEs that the node has forgotten: the whole chart says which.
  excess = status.ues < world.rows && !history.looking ? excess + 1 : 0;
  if (excess > 2 && stream.state === 'live') {
    excess = 0;
    stream.ask('sync').catch(() => {});
  }
}

stream.addEventListener('quality', ({ detail }) => {
  qualities = [...qualities, detail].slice(-KEPT);
  takeQuality();
});

async function takeQuality() {
  showQuality(qualities.at(-1));
  if ($('qualityof').value === 'time') {
    showQualityOverTime(qualities, world.knownShare() > 0);
    return;
  }
  try {
    showQualityAgainstK(await stream.ask('curve'));
  } catch (error) {
    showQualityAgainstK(null, error.message);
  }
}

// ---- once a second: ranges, key, selected UE --------------------------------------------------------------
function key() {
  const said = picture.colouring.measure(world);
  const known = world.rows === 0 || world.knownShare() > 0;
  for (const option of $('colour').options) if (option.value === 'truth' || option.value === 'error') option.disabled = !known;
  if (document.activeElement !== $('colour')) $('colour').value = said.by;
  $('truth').disabled = !known;
  $('keylow').textContent = said.low;
  $('keyhigh').textContent = said.high;
  picture.colouring.key($('keybar'), said.by);
}

let frames = 0;
function measure() {
  picture.painted = null; // ranges and ages have changed
  key();
  picture.refit();
  const fps = picture.drawn - frames;
  frames = picture.drawn;
  document.documentElement.dataset.fps = fps;
  $('counts').textContent = `${number(world.rows)} UEs · ${fps} fps`;
  refresh();
  picture.touch();
}
setInterval(measure, 1000);

let asking = false;
async function refresh() {
  const row = picture.ue === null ? undefined : world.index.get(picture.ue);
  $('user').hidden = picture.ue === null;
  if (row === undefined) return;
  const truth = showUser(world, row, hello.array, names, picture.paths);
  showHistory(world, row, $('historyof').value);
  if (history.looking) showSpectra(null, truth);
  if (asking || history.looking || stream.state === 'gone') return;
  asking = true;
  const { ue } = picture;
  try {
    const spectrum = await stream.ask('spectrum', { ue: `${ue}` });
    if (picture.ue === ue) {
      showSpectra(spectrum, truth);
      picture.bearings = showBearings(spectrum);
      picture.touch();
    }
    waterfall.take(ue, spectrum);
    const found = await stream.ask('antennas', { ue: `${ue}` });
    if (picture.ue !== ue) return;
    picture.paths = strongPaths(found);
    if ($('response').open) showResponse(found, !hello.places);
    if ($('depth').open) {
      const line = !hello.places;
      const angle = line ? world.theta[row] : Math.PI / 2 - world.azimuth[row];
      showPaths(found, { angle, rho: world.rho[row] }, picture.colouring.scalar, line);
      waterfall.show(picture.colouring.scalar);
    }
  } catch (error) {
    if (stream.state !== 'gone') toast(`No spectrum of UE ${ue}: ${error.message}`);
  } finally {
    asking = false;
  }
}

function select(ue) {
  picture.ue = ue;
  picture.paths = 0;
  picture.bearings = [];
  picture.touch();
  refresh();
  const row = world.index.get(ue);
  say(row === undefined ? 'nothing selected'
    : `UE ${names.of(ue)}, x ${number(world.x[row])}, y ${number(world.y[row])} ${world.relative?.[row] > 0 ? 'without scale' : 'metres'}, SNR ${number(world.snr[row])} decibel`);
}

/** The next UE by number, forwards or backwards. */
function step(forward) {
  const ues = [...world.index.keys()].sort((a, b) => (a < b ? -1 : 1));
  if (!ues.length) return;
  const at = ues.indexOf(picture.ue);
  select(ues[at < 0 ? (forward ? 0 : ues.length - 1) : (at + (forward ? 1 : ues.length - 1)) % ues.length]);
}

// ---- controls --------------------------------------------------------------------------------------------
function pause() {
  stream.pause(!stream.paused);
  $('pause').setAttribute('aria-pressed', stream.paused);
  $('pause').textContent = stream.paused ? 'Resume' : 'Pause';
}

function choose(id, set) {
  const apply = () => {
    set($(id).value);
    localStorage.setItem(id, $(id).value);
    key();
    picture.touch(true);
    picture.draw();
    if (picture.view.auto) picture.fit();
  };
  const kept = localStorage.getItem(id);
  if (kept && [...$(id).options].some((o) => o.value === kept)) $(id).value = kept;
  $(id).addEventListener('change', apply);
  set($(id).value);
}

function cycle(id) {
  const select = $(id);
  do select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
  while (select.options[select.selectedIndex].disabled);
  select.dispatchEvent(new Event('change'));
  say(`${id}: ${select.value}`);
}

function caption() {
  const report = qualities.at(-1);
  const quality = report ? ` · TW ${number(report.tw, 4)}, CT ${number(report.ct, 4)} (K = ${report.k})` : '';
  return `${hello?.array.name ?? ''} · ${number(world.rows)} UEs · θ ${$('theta').value}, ρ ${$('rho').value}${quality} · ${new Date(world.newest).toISOString().slice(0, 19)} UTC`;
}

const png = () => savePng(picture, caption(), hello?.array.name ?? 'node');
const drawing = (kind) => saveDrawing(picture, caption(), hello?.array.name ?? 'node', kind);
const csv = () => saveCsv(world, hello?.array.name ?? 'node', { theta: $('theta').value, rho: $('rho').value });
const dark = () => document.documentElement.dataset.theme === 'dark';

choose('colour', (value) => (picture.colouring.by = value));
choose('truth', (value) => (picture.truth = value));
$('trails').addEventListener('change', () => {
  picture.trails = $('trails').checked;
  picture.touch(true);
});
$('find').addEventListener('submit', (event) => {
  event.preventDefault();
  const ue = names.find($('ue').value, world);
  if (ue !== null) {
    select(ue);
    $('plot').focus();
  } else toast(`No UE ${$('ue').value.trim()} in the chart`);
});
for (const kind of ['theta', 'rho']) $(kind).addEventListener('change', () => changeMethod(stream, kind, toast));
$('qualityof').addEventListener('change', takeQuality);
$('historyof').addEventListener('change', refresh);
for (const id of ['response', 'depth']) $(id).addEventListener('toggle', refresh);
$('follow').addEventListener('change', () => {
  picture.follow = $('follow').checked;
  picture.touch(true);
});
const clicks = {
  ues: () => list.show(),
  plan: () => plan.show(),
  pause, record: () => recordings.startOrStop(), png, svg: () => drawing('svg'), pdf: () => drawing('pdf'), csv, theme: () => theme(dark() ? 'light' : 'dark'), reset: () => picture.fit(), close: () => select(null),
  in: () => picture.view.zoom(1.4), out: () => picture.view.zoom(1 / 1.4), help: () => $('keys').showModal(), cancel: () => $('recording').close(),
};
for (const [id, run] of Object.entries(clicks)) $(id).addEventListener('click', run);

bindKeys([
  [[' '], 'pause or resume', () => (replay.shown ? replay.toggle() : pause())],
  [['n', 'p'], 'next, previous UE', (event) => step(event.key === 'n')],
  [['u'], 'all UEs as a table', () => list.show()],
  [['f'], 'follow the UE', () => $('follow').click()],
  [['/'], 'find a UE by its number or name', () => $('ue').focus()],
  [['Escape'], 'let go of the UE', () => select(null)],
  [['ArrowLeft', 'ArrowRight', 'ArrowUp', 'ArrowDown'], 'move the view', ({ key: k, shiftKey }) => {
    const far = shiftKey ? 200 : 50;
    picture.view.pan({ ArrowLeft: far, ArrowRight: -far }[k] ?? 0, { ArrowUp: far, ArrowDown: -far }[k] ?? 0);
  }],
  [['+', '=', '-', '_'], 'zoom in, out', (event) => picture.view.zoom('+='.includes(event.key) ? 1.4 : 1 / 1.4)],
  [['0'], 'show everything', () => picture.fit()],
  [['c'], 'next colouring', () => cycle('colour')],
  [['t'], 'truth beside, under, off', () => cycle('truth')],
  [['l'], 'trails on or off', () => $('trails').click()],
  [['m'], 'choose the method', () => $('theta').focus()],
  [['r'], 'record, or stop recording', () => recordings.startOrStop()],
  [['s'], 'save the picture (PNG)', png],
  [['g', 'o'], 'save the picture for a paper: SVG, PDF', (event) => drawing(event.key === 'g' ? 'svg' : 'pdf')],
  [['e'], 'save the table (CSV)', csv],
  [['d'], 'dark or light', () => clicks.theme()],
  [['?'], 'these keys', () => $('keys').showModal()],
], $('keylist'));

new ResizeObserver(() => redraw(document.querySelectorAll('.curve'))).observe(document.querySelector('aside'));
document.addEventListener('visibilitychange', () => {
  if (!stream.paused) stream.ask('stream', { on: !document.hidden }).catch(() => {});
});
theme();

/** For the browser's console, and for tests. */
window.chachart = { world, picture, stream };
