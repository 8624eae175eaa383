// Every action has a key; `?` shows them.

/** actions: [[keys, description, function]]; keys are KeyboardEvent.key values. */
export function bindKeys(actions, list) {
  const table = new Map();
  const names = { ' ': 'space', ArrowLeft: '←', ArrowRight: '→', ArrowUp: '↑', ArrowDown: '↓', Escape: 'Esc' };
  for (const [keys, description, run] of actions) {
    const term = document.createElement('dt');
    keys.filter((key) => !(key === '=' || key === '_')).forEach((key) => {
      const cap = document.createElement('kbd');
      cap.textContent = names[key] ?? key;
      term.append(cap, ' ');
    });
    const meaning = document.createElement('dd');
    meaning.textContent = description;
    list.append(term, meaning);
    for (const key of keys) table.set(key, run);
  }
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (document.querySelector('dialog[open]')) return;
    const busy = event.target.closest('input:not([type="checkbox"], [type="range"]), select, textarea');
    if (busy && event.key !== 'Escape') return;
    if (event.key === ' ' && event.target.closest('button, input[type="checkbox"]')) return;
    if (event.target.closest('input[type="range"]') && event.key.startsWith('Arrow')) return;
    const run = table.get(event.key);
    if (!run) return;
    event.preventDefault();
    if (busy) busy.blur();
    else run(event);
  });
}
