"""The report: one HTML file that loads nothing, for light and dark screens and for paper."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from string import Template

import numpy as np

from chachart.node.commands.reproduction import paper
from chachart.node.commands.reproduction.accuracy import JUDGED_FROM_DB, THRESHOLD_RATIO, Accuracy
from chachart.node.commands.reproduction.paper import published
from chachart.node.commands.reproduction.results import WRITTEN, ChannelResults, Results
from chachart.node.commands.reproduction.runs import Charted, display
from chachart.node.commands.reproduction.scenario import KNOWN_UES


@dataclass(slots=True)
class Cell:
    """A table's cell, and whether it is better or worse than published."""

    text: str
    verdict: str = ""


Row = Sequence[str | Cell]
Pictures = dict[str, dict[str, bytes]]
"""PNG files by figure and theme."""


@dataclass(slots=True)
class _Page:
    """The page's sections as they come."""

    body: list[str] = field(default_factory=list)
    contents: list[str] = field(default_factory=list)

    def section(self, anchor: str, title: str) -> None:
        self.contents.append(f'<li><a href="#{anchor}">{escape(title)}</a></li>')
        self.body.append(f'<h2 id="{anchor}">{escape(title)}</h2>')

    def text(self, html: str) -> None:
        self.body.append(f"<p>{html}</p>")


def render(results: Results, pictures: Pictures) -> str:
    """The whole page."""
    page = _Page()
    _overview(page, results, pictures)
    for channel in results.channels:
        _channel(page, channel, pictures)
    if any(channel.ranging for channel in results.channels):
        _ranging(page, results.channels)
    if results.accuracy:
        _accuracy(page, results, pictures)
    _circumstances(page, results)
    template = Template(files(__package__).joinpath("report.html").read_text("utf-8"))
    names = ", ".join(WRITTEN[channel.name] for channel in results.channels)
    settings = results.settings
    return template.substitute(
        title="Channel charts beside the published ones",
        subtitle=escape(
            f"{names}: {settings['ues']} UEs, {settings['frames']} frames each at {settings['snr_db']:g} dB, "
            f"{settings['bandwidth_hz'] / 1e6:g} MHz in all"
        ),
        contents="\n".join(page.contents),
        body="\n".join(page.body),
    )


def table(header: Sequence[str], rows: Sequence[Row], caption: str = "") -> str:
    """An HTML table; the first column names the row."""
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in header)
    lines = []
    for row in rows:
        cells = [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]
        first = f'<th scope="row">{escape(cells[0].text)}</th>'
        rest = [
            f'<td class="{cell.verdict}">{escape(cell.text)}</td>'
            if cell.verdict
            else f"<td>{escape(cell.text)}</td>"
            for cell in cells[1:]
        ]
        lines.append(f"<tr>{first}{''.join(rest)}</tr>")
    told = f"<caption>{escape(caption)}</caption>" if caption else ""
    body = "\n".join(lines)
    inside = f"{told}<thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody>"
    return f'<div class="wide"><table>{inside}</table></div>'


def compared(here: float, there: float) -> Cell:
    """TW or CT here against the published one, to the four digits that were published."""
    difference = round(round(here, 4) - there, 4)
    if difference == 0:
        return Cell("=")
    return Cell(f"▲ {difference:+.4f}", "good") if difference > 0 else Cell(f"▼ {difference:+.4f}", "bad")


def picture(name: str, pictures: Pictures, words: str) -> str:
    """A figure that follows the page's colours, its data in the page."""
    data = {
        theme: "data:image/png;base64," + base64.b64encode(png).decode()
        for theme, png in pictures[name].items()
    }
    return (
        f'<figure><picture><source media="(prefers-color-scheme: dark)" srcset="{data["dark"]}">'
        f'<img src="{data["light"]}" alt="{escape(words)}"></picture>'
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )


def _overview(page: _Page, results: Results, pictures: Pictures) -> None:
    page.section("overview", "At a glance")
    page.text(f"Published numbers: {escape(paper.CITATION)}.")
    items = []
    for channel in results.channels:
        rows = [
            (c, before)
            for pair, c in zip(channel.pairs, channel.charted, strict=True)
            if (before := published(channel.name, pair)) is not None
        ]
        if not rows:
            continue
        tw = sum(round(float(c.tw[-1]), 4) >= before.tw for c, before in rows)
        ct = sum(round(float(c.ct[-1]), 4) >= before.ct for c, before in rows)
        words = f"<b>{WRITTEN[channel.name]}</b>: of {len(rows)} published pairs, TW is at least as good "
        words += f"in {tw}, CT in {ct}"
        ratios = [before.seconds / c.mean_seconds for c, before in rows if before.seconds is not None]
        if ratios:
            words += (
                f"; {sum(r > 1 for r in ratios)} are faster, by {min(ratios):.1f} to {max(ratios):.0f} times"
            )
        items.append(f"<li>{words}.</li>")
    page.body.append(f"<ul>{''.join(items)}</ul>")
    if len(results.channels[0].truth) != paper.UES:
        page.text(f"<b>The published numbers are for {paper.UES} UEs</b>, not as many as here.")
    if results.settings["bandwidth_hz"] != paper.BANDWIDTH_HZ:
        page.text(f"<b>The published numbers are for {paper.BANDWIDTH_HZ / 1e3:g} kHz in all.</b>")
    page.body.append(
        picture(
            "summary",
            pictures,
            "Trustworthiness and continuity of every pair, published (hollow) and here (filled); "
            "to the right is better.",
        )
    )


def _channel(page: _Page, channel: ChannelResults, pictures: Pictures) -> None:
    name = WRITTEN[channel.name]
    page.section(channel.name, f"{name}: TW, CT and seconds")
    timed = any((p := published(channel.name, pair)) and p.seconds for pair in channel.pairs)
    header = ["theta / rho", "TW published", "TW here", "", "CT published", "CT here", ""]
    header += ["s published", "s here", "times faster"] if timed else ["s here"]
    header += ["median error (m)", "variance of θ", "variance of ρ"]
    rows = [
        _row(c, published(channel.name, pair), timed)
        for pair, c in zip(channel.pairs, channel.charted, strict=True)
    ] + [_row(c, None, timed) for c in channel.embeddings]
    page.body.append(
        table(header, rows, f"{channel.origin}; K = {channel.k} neighbours of {len(channel.truth)} UEs")
    )
    words = (
        f"{name}: true positions and charts with their TW and CT, every UE in the colour of its true "
        "position, the letters in ink. PCA and Sammon’s mapping are turned, mirrored and scaled to fit."
    )
    page.body.append(picture(f"charts-{channel.name}", pictures, words))
    words = (
        f"{name}: TW and CT for K = 1 … {channel.k} neighbours, on a logarithmic scale of what lacks to 1."
    )
    page.body.append(picture(f"curves-{channel.name}", pictures, words))


def _row(c: Charted, before: paper.Published | None, timed: bool) -> Row:
    tw, ct = float(c.tw[-1]), float(c.ct[-1])
    row: list[str | Cell] = [c.name]
    for here, there in ((tw, before.tw if before else None), (ct, before.ct if before else None)):
        row += ["–" if there is None else f"{there:.4f}", f"{here:.4f}"]
        row.append("" if there is None else compared(here, there))
    if timed:
        there = before.seconds if before else None
        row.append("–" if there is None else f"{there:.4f}")
    row.append(f"{c.mean_seconds:.3f}")
    if timed and there is not None:
        ratio = there / c.mean_seconds
        row.append(Cell(f"{ratio:.1f}", "good" if ratio > 1 else "bad"))
    elif timed:
        row.append("")
    row.append(f"{c.error_m:.2f}")
    return [*row, *("–" if np.isnan(v) else f"{v:.3g}" for v in c.variances)]


def _ranging(page: _Page, channels: Sequence[ChannelResults]) -> None:
    page.section("ranging", "Range from the amplitude")
    page.text(
        "TW / CT and, in parentheses, the median relative error of ρ, with θ by Bartlett. The amplitude is "
        "taken from the mean power less the noise (debiased, the default), from |mean of h| of a subcarrier "
        "(coherent, as published), or from the mean of |h| (noisy). LR learns from "
        f"{KNOWN_UES} UEs with a known position: the first ones, most of which draw the letters, or as many "
        "drawn at random; log-log fits log ρ."
    )
    amplitudes = list(dict.fromkeys(r.amplitude for channel in channels for r in channel.ranging))
    for channel in channels:
        if not channel.ranging:
            continue
        rows = []
        for way in dict.fromkeys(r.way for r in channel.ranging):
            of = {r.amplitude: r for r in channel.ranging if r.way == way}
            cells = [f"{of[a].tw:.4f} / {of[a].ct:.4f}  ({of[a].rho_error:.1%})" for a in amplitudes]
            rows.append([way, *cells])
        page.body.append(table(["ρ by", *amplitudes], rows, WRITTEN[channel.name]))


def _accuracy(page: _Page, results: Results, pictures: Pictures) -> None:
    page.section("accuracy", "Errors on a single path and the Cramér-Rao bound")
    page.text(
        f"{results.settings['paths']} paths at each SNR, {results.settings['frames']} frames each, θ uniform "
        "over 30…150°, ρ over 100…600 m; each method for both coordinates. The upper bound holds for a "
        "source of unknown, Gaussian samples, which is all that a covariance tells; the lower one for a "
        "constant source, which the joint method makes use of. ρ is looked for within 0…1000 m, so at "
        "very low SNR errors stay finite."
    )
    page.body.append(
        picture("accuracy", pictures, "Root mean squared errors against the SNR, with both bounds.")
    )
    header = ["method", *(_coordinate(a) for a in results.accuracy)]
    rows = []
    for method in results.accuracy[0].rmse:
        cells = []
        for a in results.accuracy:
            mean, worst = a.judged(method)
            threshold = a.threshold_db(method)
            since = "never" if threshold is None else f"{threshold:+g} dB"
            cells.append(f"{mean:.3f} ({worst:.3f}), {since}")
        rows.append([display((method,) * 2).split(" / ")[0], *cells])
    caption = (
        f"Error over bound, mean (largest) from {JUDGED_FROM_DB:g} dB on; the SNR from which on it stays "
        f"below {THRESHOLD_RATIO}: under that, the threshold effect sets in."
    )
    page.body.append(table(header, rows, caption))


def _coordinate(a: Accuracy) -> str:
    return f"{'θ' if a.coordinate == 'theta' else 'ρ'}, {a.bandwidth_hz / 1e6:g} MHz"


def _circumstances(page: _Page, results: Results) -> None:
    page.section("circumstances", "How this was made")
    facts = {"command": f"<code>{escape(results.command)}</code>"}
    facts |= {name: escape(str(value)) for name, value in results.settings.items()}
    facts |= {name: escape(value) for name, value in results.machine.items()}
    facts["time in all"] = f"{results.seconds:.0f} s, on one core"
    page.body.append(
        "<dl>"
        + "".join(f"<dt>{escape(n.replace('_', ' '))}</dt><dd>{v}</dd>" for n, v in facts.items())
        + "</dl>"
    )
