// The figures beside the chart: node, quality and the selected UE.

import { curve } from './curve.js';

const DEGREES = 180 / Math.PI;
const element = (id) => document.getElementById(id);

/** A number for people: few digits, a true minus, a dash where it is unknown. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return '–';
  const size = Math.abs(value);
  const text = size >= 10 ** digits || Number.isInteger(value) ? value.toFixed(0)
    : value.toFixed(Math.max(0, Math.min(6, digits - 1 - Math.floor(Math.log10(size)))));
  return text.replace('-', '−').replace(/\B(?=(\d{3})+(?!\d)(?<!\.\d*))/g, '\u202f');
}

/** Fill a <dl>: [[name, value, {unit, kind}]]; kind is '', 'big', 'long' or 'warn'. */
export function facts(list, rows) {
  list.replaceChildren(...rows.map(([name, value, { unit = '', kind = '' } = {}]) => {
    const row = document.createElement('div');
    row.className = kind;
    const term = document.createElement('dt');
    term.textContent = name;
    const data = document.createElement('dd');
    data.textContent = value;
    if (unit) {
      const small = document.createElement('small');
      small.textContent = kind === 'big' ? unit : ` ${unit}`;
      data.append(small);
    }
    row.append(term, data);
    return row;
  }));
}

const seconds = (s) => (s < 120 ? `${s.toFixed(0)} s` : s < 7200 ? `${(s / 60).toFixed(0)} min` : s < 172800 ? `${(s / 3600).toFixed(1)} h` : `${(s / 86400).toFixed(1)} days`);

/** The node's counters and rates; `past` are earlier reports, oldest first. */
export function showNode(status, past) {
  const dropped = Object.entries({ ...status.dropped, ...status.rejected }).filter(([, n]) => n > 0);
  const lost = dropped.reduce((sum, [, n]) => sum + n, 0);
  facts(element('nodefacts'), [
    ['Frames', number(status.frames_estimated_per_s, 4), { unit: 'per s', kind: 'big' }],
    ['Latency', number(status.latency_ms?.p50), { unit: `ms, 99 % ${number(status.latency_ms?.p99)}`, kind: 'big' }],
    ['State', status.state ?? '–'],
    ['Up', seconds(status.seconds ?? 0)],
    ['Frames in', number(status.frames_in)],
    ['Estimated', number(status.frames_estimated)],
    ['UEs', number(status.ues)],
    ['Dropped', number(lost), { kind: lost ? 'warn' : '' }],
    ['Waiting', number(status.backlog_frames)],
    ['Source', status.source ?? '–'],
    ...(status.recording ? [['Recording', status.recording, { kind: 'long' }]] : []),
  ]);
  facts(element('drops'), dropped.map(([reason, n]) => [`dropped, ${reason.replaceAll('_', ' ')}`, number(n), { kind: 'long warn' }]));
  const body = element('workers').tBodies[0];
  body.replaceChildren(...(status.workers ?? []).map((worker, i) => {
    const row = document.createElement('tr');
    for (const text of [`${worker.shard ?? i}`, number(worker.frames_estimated), number(worker.backlog_frames), number(worker.restarts)]) {
      row.insertCell().textContent = text;
    }
    return row;
  }));
  const now = past.at(-1)?.time_ns ?? 0;
  curve(element('rateplot'), {
    series: [{ x: past.map((s) => (s.time_ns - now) / 1e9), y: past.map((s) => s.frames_estimated_per_s), colour: 'a' }],
    x: { label: 's ago' },
    y: { label: 'frames/s' },
  });
}

const shares = (v) => (Number.isFinite(v) ? v.toFixed(4) : '–');
const lines = (x, tw, ct) => [{ x, y: tw, colour: 'a', name: 'TW' }, { x, y: ct, colour: 'b', name: 'CT' }];

/** The latest quality report, if there is any. */
export function showQuality(report) {
  facts(element('qualityfacts'), !report ? [] : [
    ['Trustworthiness', shares(report.tw), { unit: `K = ${report.k}`, kind: 'big' }],
    ['Continuity', shares(report.ct), { unit: `${number(report.ues)} UEs`, kind: 'big' }],
    ['Error as it is, median', number(report.error_m), { unit: 'm', kind: 'long' }],
    ['90 %', number(report.error_p90_m), { unit: 'm' }],
    ['Mean', number(report.error_mean_m), { unit: 'm' }],
    ['After the best fit', number(report.fit_error_m), { unit: 'm', kind: 'long' }],
    ...(report.warnings ?? []).map((words) => ['Beware', words]),
    ['Stress', number(report.stress)],
  ]);
}

const QUALITY_AXIS = { label: '', least: 0.004, limits: [0, 1] };

/** TW and CT over time; `past` are reports, oldest first; `known`: whether any UE's position is known. */
export function showQualityOverTime(past, known) {
  const now = past.at(-1)?.time_ns;
  curve(element('qualityplot'), {
    series: lines(past.map((r) => (r.time_ns - now) / 1e9), past.map((r) => r.tw), past.map((r) => r.ct)),
    x: { label: 's ago' }, y: QUALITY_AXIS, empty: known ? 'not worked out yet' : 'needs UEs whose position is known',
  });
}

/** TW and CT against the number of neighbours: {k, tw, ct}, or why there is no such curve. */
export function showQualityAgainstK(found, empty) {
  curve(element('qualityplot'), {
    series: found ? lines(found.k, found.tw, found.ct) : [],
    x: { label: 'K' }, y: QUALITY_AXIS, empty,
  });
}

const decibels = (values) => {
  const top = Math.max(...values.filter(Number.isFinite));
  return values.map((v) => Math.max(10 * Math.log10(v / top), -60));
};

/** The numbers of one UE, from the table. */
export function showUser(world, row, array, names, paths) {
  const truth = Number.isFinite(world.true_x[row]);
  const age = (world.now() - world.time[row]) / 1000;
  const relative = Boolean(world.relative?.[row]);
  const angle = Number.isFinite(world.azimuth?.[row]) ? 'azimuth' : 'theta';
  const called = names.of(world.ue[row]);
  element('username').textContent = called === `${world.ue[row]}` ? `UE ${called}` : `${called} · UE ${world.ue[row]}`;
  facts(element('userfacts'), [
    [angle === 'azimuth' ? 'azimuth' : 'θ', `${number(world[angle][row] * DEGREES, 4)}°`, { unit: `± ${number(world[`${angle}_std`][row] * DEGREES, 2)}°`, kind: 'big' }],
    ['ρ', number(world.rho[row], 4), { unit: relative ? 'without scale' : `± ${number(world.rho_std[row], 2)} m`, kind: 'big' }],
    ...(paths > 1 ? [['± holds for', `one path, there are ${paths}`, { kind: 'long warn' }]] : []),
    ['x', number(world.x[row], 4), { unit: relative ? '' : 'm' }],
    ['y', number(world.y[row], 4), { unit: relative ? '' : 'm' }],
    ...(world.present.has('vx') && Number.isFinite(world.vx[row]) ? [['Speed', number(Math.hypot(world.vx[row], world.vy[row])), { unit: 'm/s' }]] : []),
    ...(world.present.has('arrays') ? [['Arrays', number(world.arrays[row])]] : []),
    ...(world.present.has('outlier') ? [['Outlier', `${Math.round(100 * world.outlier[row])} %`, { kind: world.outlier[row] > 0.5 ? 'warn' : '' }]] : []),
    ['SNR', world.snr[row].toFixed(1).replace('-', '−'), { unit: 'dB' }],
    ['Frames', number(Math.round(world.snapshots[row] * 10) / 10), { unit: 'effective' }],
    ['Last heard', `${Math.max(age, 0).toFixed(1)}`, { unit: 's ago' }],
    ...(angle === 'theta' ? [['Off broadside', `${number(90 - world.theta[row] * DEGREES, 3)}°`]] : []),
    ['Error', truth ? number(world.error(row)) : '–', { unit: truth ? 'm' : 'no truth' }],
  ]);
  if (!truth) return {};
  const height = array.height_m ?? 0;
  const { true_x: x, true_y: y } = world;
  const rho = Math.hypot(x[row], y[row], height);
  return { theta: Math.acos(y[row] / rho), rho };
}

/** Both spectra of the selected UE with peak and standard deviation; null of a time whose spectra are not kept. */
export function showSpectra(spectrum, truth) {
  const plot = (canvas, grid, values, peak, std, scale, range, unit, known) => {
    const at = peak * scale;
    const half = (std ?? NaN) * scale;
    curve(element(canvas), {
      series: values ? [{ x: grid.map((v) => v * scale), y: decibels(values), colour: 'a' }] : [],
      x: { label: unit, range }, y: { label: 'dB' },
      bands: half > 0 ? [[at - half, at + half]] : [],
      marks: [...(Number.isFinite(known) ? [{ x: known * scale, colour: 'b', dashed: true, name: 'truth' }] : []),
        { x: at, colour: 'accent', name: 'peak ± σ' }],
      empty: spectrum ? 'this method has no spectrum' : 'not kept for the past',
    });
  };
  const s = spectrum ?? {};
  plot('thetaplot', s.theta_grid_rad, s.theta_spectrum, s.theta, s.theta_std, DEGREES, [0, 180], '°', truth.theta);
  plot('rhoplot', s.rho_grid_m, s.rho_spectrum, s.rho, s.rho_std, 1, undefined, 'm', truth.rho);
}

/** Where the selected UE has been. */
export function showHistory(world, row, quantity) {
  const past = world.historyOf(row);
  const now = world.now();
  const [scale, label] = { theta: [DEGREES, 'θ, °'], rho: [1, world.relative?.[row] > 0 ? 'ρ, no scale' : 'ρ, m'], snr: [1, 'SNR, dB'] }[quantity];
  curve(element('historyplot'), {
    series: [{ x: [...past.time, world.time[row]].map((t) => (t - now) / 1000), y: [...past[quantity], world[quantity][row]].map((v) => v * scale), colour: 'a' }],
    x: { label: 's ago' }, y: { label },
  });
}
