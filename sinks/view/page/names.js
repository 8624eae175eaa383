// What people call UEs: by a name, a MAC address or a number.

export class Names {
  constructor() {
    this.byUe = new Map();
  }

  take(names) {
    this.byUe = new Map(Object.entries(names ?? {}).map(([ue, name]) => [BigInt(ue), name]));
  }

  /** A UE for people; numbers of 33 to 48 bits are MAC addresses. */
  of(ue) {
    const name = this.byUe.get(ue);
    if (name !== undefined) return name;
    if (ue > 0xffffffffn && ue <= 0xffffffffffffn) return ue.toString(16).padStart(12, '0').match(/../g).join(':');
    return `${ue}`;
  }

  /** The UE of the chart that a text means: number, MAC, name, or the only one whose name has it in it. */
  find(text, world) {
    const wanted = text.trim().toLowerCase();
    if (!wanted) return null;
    const mac = wanted.replace(/[:-]/g, '');
    const number = /^\d{1,20}$/.test(wanted) ? BigInt(wanted) : mac.length === 12 && /^[0-9a-f]+$/.test(mac) ? BigInt(`0x${mac}`) : null;
    if (number !== null && world.index.has(number)) return number;
    const called = [...this.byUe].filter(([ue, name]) => world.index.has(ue) && name.toLowerCase().includes(wanted));
    const exact = called.filter(([, name]) => name.toLowerCase() === wanted);
    return (exact[0] ?? (called.length === 1 ? called[0] : null))?.[0] ?? null;
  }
}
