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

/** The two choices go together: the joint method is one for both; auto goes with any theta. */
export async function changeMethod(stream, changed, toast) {
  const other = changed === 'theta' ? 'rho' : 'theta';
  const chosen = { theta: $('theta').value, rho: $('rho').value };
  if (chosen.rho !== 'auto' && chosen[changed] === 'joint') chosen[other] = 'joint';
  else if (chosen.rho !== 'auto' && chosen[other] === 'joint') chosen[other] = chosen[changed] === 'isq' || chosen[changed] === 'lr' ? 'bartlett' : chosen[changed];
  try {
    await stream.ask('method', chosen);
    Object.assign($(other), { value: chosen[other] });
    toast(`Estimating θ with ${chosen.theta}, ρ with ${chosen.rho}`);
  } catch (error) {
    toast(`The method stays: ${error.message}`);
  }
  $(changed).blur();
}

/** Whether it is out of reach at the moment. */
export const locked = () => $('record').disabled;
