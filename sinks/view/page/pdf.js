// An SVG of `saveSvg` as a PDF of one page, as vectors (ISO 32000-1, 7.5, 8.4, 8.5 and 9.4).

const INTO_LATIN = { '\u2212': '-', θ: 'theta', ρ: 'rho', '…': '...', '–': '-' };
const ROUND_ARC = 0.5523; // of a quarter circle by one Bézier curve

/** A literal string in Latin-1, of what the standard fonts have. */
function literal(text) {
  const latin = [...text].map((c) => INTO_LATIN[c] ?? (c.codePointAt(0) < 256 ? c : '?')).join('');
  return [latin, `(${latin.replace(/[\\()]/g, '\\$&')})`];
}

/** Colours of CSS as the three numbers of PDF. */
function colourReader() {
  const context = Object.assign(document.createElement('canvas'), { width: 1, height: 1 }).getContext('2d', { willReadFrequently: true });
  const known = new Map();
  return (name) => {
    if (!known.has(name)) {
      context.fillStyle = name;
      context.fillRect(0, 0, 1, 1);
      known.set(name, [...context.getImageData(0, 0, 1, 1).data.slice(0, 3)].map((v) => (v / 255).toFixed(3)).join(' '));
    }
    return known.get(name);
  };
}

function operators(svg, width, height) {
  const colour = colourReader();
  const measure = document.createElement('canvas').getContext('2d');
  measure.font = '11px Helvetica, Arial, sans-serif';
  const out = [];
  const number = (element, name) => parseFloat(element.getAttribute(name) ?? 0);
  const box = (element) => {
    const share = (name, whole) => (element.getAttribute(name) === '100%' ? whole : number(element, name));
    return `${number(element, 'x')} ${number(element, 'y')} ${share('width', width)} ${share('height', height)} re`;
  };
  const draw = {
    rect: (e) => out.push(e.getAttribute('fill') === 'none' ? `${colour(e.getAttribute('stroke'))} RG ${box(e)} S` : `${colour(e.getAttribute('fill'))} rg ${box(e)} f`),
    path: (e) => {
      out.push(`${colour(e.getAttribute('stroke'))} RG`);
      for (const [, x, y, way, to] of e.getAttribute('d').matchAll(/M(\S+) ([^VH]+)([VH])([^M]+)/g)) out.push(`${x} ${y} m ${way === 'V' ? `${x} ${to}` : `${to} ${y}`} l S`);
    },
    circle: (e) => {
      const [x, y, r] = ['cx', 'cy', 'r'].map((name) => number(e, name));
      const at = (dx, dy) => `${(x + dx * r).toFixed(2)} ${(y + dy * r).toFixed(2)}`;
      const k = ROUND_ARC;
      out.push(`${colour(e.getAttribute('fill'))} rg ${at(1, 0)} m ${at(1, k)} ${at(k, 1)} ${at(0, 1)} c ${at(-k, 1)} ${at(-1, k)} ${at(-1, 0)} c ${at(-1, -k)} ${at(-k, -1)} ${at(0, -1)} c ${at(k, -1)} ${at(1, -k)} ${at(1, 0)} c f`);
    },
    text: (e) => {
      const [latin, words] = literal(e.textContent);
      const before = { start: 0, middle: 0.5, end: 1 }[e.getAttribute('text-anchor')] * measure.measureText(latin).width;
      out.push(`BT ${colour(e.getAttribute('fill'))} rg /F 11 Tf 1 0 0 -1 ${(number(e, 'x') - before).toFixed(2)} ${number(e, 'y')} Tm ${words} Tj ET`);
    },
    g: (e) => {
      const id = e.getAttribute('clip-path').slice(5, -1);
      out.push(`q ${box(svg.getElementById(id).firstElementChild)} W n`);
      for (const child of e.children) draw[child.tagName](child);
      out.push('Q');
    },
    clipPath: () => {},
  };
  for (const element of svg.documentElement.children) draw[element.tagName](element);
  return `1 0 0 -1 0 ${height} cm\n${out.join('\n')}`;
}

/** The bytes of the PDF; a unit of the SVG is a point. */
export function pdfOf(text) {
  const svg = new DOMParser().parseFromString(text, 'image/svg+xml');
  const [width, height] = ['width', 'height'].map((name) => parseFloat(svg.documentElement.getAttribute(name)));
  const content = operators(svg, width, height);
  const objects = [
    '<< /Type /Catalog /Pages 2 0 R >>',
    '<< /Type /Pages /Kids [3 0 R] /Count 1 >>',
    `<< /Type /Page /Parent 2 0 R /MediaBox [0 0 ${width} ${height}] /Contents 4 0 R /Resources << /Font << /F 5 0 R >> >> >>`,
    `<< /Length ${content.length} >>\nstream\n${content}\nendstream`,
    '<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>',
  ];
  let file = '%PDF-1.4\n';
  const places = objects.map((object, i) => {
    const place = file.length;
    file += `${i + 1} 0 obj\n${object}\nendobj\n`;
    return `${place}`.padStart(10, '0');
  });
  const end = file.length;
  file += `xref\n0 ${objects.length + 1}\n0000000000 65535 f \n${places.map((place) => `${place} 00000 n \n`).join('')}`;
  file += `trailer\n<< /Size ${objects.length + 1} /Root 1 0 R >>\nstartxref\n${end}\n%%EOF\n`;
  return Uint8Array.from(file, (c) => c.charCodeAt(0));
}
