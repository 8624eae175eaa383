// What steers the node: out of reach while the node is gone, and for people who may only look.

const $ = (id) => document.getElementById(id);
const STEERING = ['theta', 'rho', 'record', 'play', 'seek', 'speed', 'planfile', 'planremove'];
const ONLY_LOOK = 'You are signed in to look; only the steering token lets you change anything.';
const titles = new Map();

/** `maySteer` as the node's hello has it; undefined before it came. */
export function lock(gone, maySteer) {
  for (const id of STEERING) {
    const control = $(id);
    if (!titles.has(id)) titles.set(id, control.title);
    control.disabled = gone || !maySteer;
    control.title = maySteer === false ? ONLY_LOOK : titles.get(id);
  }
  $('onlylook').hidden = maySteer !== false;
  $('onlylook').title = ONLY_LOOK;
}

/** Whether it is out of reach at the moment. */
export const locked = () => $('record').disabled;
