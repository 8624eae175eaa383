// How things are, in a word or two, and what to do about it.

const $ = (id) => document.getElementById(id);
const WORDS = { live: 'live', paused: 'paused', gone: 'node gone', ended: 'node ended', connecting: 'connecting' };

/**
 * `link` is the stream's state, or `ended` where the node has ended as it should; `status` the node's last one, if
 * any came; `plays` how a recording is being played, if one is; `past` whether the page looks at the past.
 */
export function showState(link, status, plays, past) {
  const { state, reason, fix } = status ?? {};
  const over = Boolean(plays?.ended);
  const still = past || Boolean(plays?.paused);
  const ill = link === 'live' && !still && !over && Boolean(reason) && state !== 'running';
  $('notice').hidden = !ill || state === 'starting';
  if (ill) $('notice').textContent = [reason, fix].filter(Boolean).join(' – ');
  $('waiting').textContent = ill ? reason : 'waiting for the first estimates';
  $('link').dataset.state = link === 'ended' || over ? 'ended' : still ? 'paused' : ill ? 'degraded' : link;
  $('link').textContent = past ? 'in the past' : over ? 'end of the recording' : still ? 'paused' : ill ? state : plays ? 'replay' : WORDS[link];
}
