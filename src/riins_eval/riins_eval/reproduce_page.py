"""The page of a reproduction: a table and the figures of each chapter in one HTML document that needs nothing else.

Lives here: `page`, and `draw`, a study's figure as PNG.
Does not live here: the numbers (studies/), running them (reproduce.py), the look (draw_html.py, draw_png.py).
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from .draw_html import STYLE
from .draw_png import STYLE as PNG_STYLE
from .studies.rows import Figure, Row

if TYPE_CHECKING:
    from .reproduce import Part, Reproduction

_MORE = """
td.number, th.number { text-align: right; white-space: nowrap; padding-left: 6px } td small { display: block; color: var(--muted); max-width: 68ch }
td.mark { text-align: center; font-weight: 700 } .yes { color: var(--good) } tr.missed td { background: #fef2f2 }
img { display: block; width: 100%; height: auto; margin-top: 8px } h2.chapter { margin: 28px 0 10px; font-size: 22px }
"""
_FIGURES = {"axes.titlesize": 10, "legend.frameon": True, "legend.framealpha": 0.85, "legend.edgecolor": "white"}
_VERDICT = "✓ reaches what is demanded, ✗ does not, · nothing is demanded."
_READING = {
    "thesis": (
        "Target: number of a demand on this implementation, where there is one. Thesis: the value printed there. Ours: mean over the seeds, or the "
        f"one value, with the 5th and 95th percentile; n: how many. {_VERDICT} The sentence under a name says what the reader must know: where a "
        "printed claim does not hold, and why."
    ),
    "paper": (
        "Target: number of a demand on this implementation, where there is one. Paper: the value printed there. Ours: mean over the seeds where the "
        f"row does not say RMS or median, with the 5th and 95th percentile; n: how many. {_VERDICT} Under a name: what the reader must know."
    ),
    "expected": (
        "Expected: what is known of the recording, or asked of the method. Ours: the share of the cases with its 5 and 95 % bounds (Wilson), or the "
        f"median with the 5th and 95th percentile, or the mean of gyros and accelerometers with both; n: how many. {_VERDICT}"
    ),
    "reference": (
        "Target: number of a demand on this implementation, where there is one. Reference: what an independent implementation reached. Ours: mean or "
        f"median over the seeds with the 5th and 95th percentile; n: how many. {_VERDICT} Under a name: what the reader must know."
    ),
    "wanted": (
        "Wanted: what is asked of the navigator. Ours: median over the runs, or the mean of a share, or the sum of a count, with the 5th "
        f"and 95th percentile; n: how many. {_VERDICT} Under a name: the worst case, and how many were found."
    ),
}
_FOOTER = "Written by RIINS; this page needs no network. The same rows are in rows.json, the figures beside it as PNG."
_MARKS = {True: "<span class=yes title='reaches what is demanded'>✓</span>", False: "<span class=no title='does not reach it'>✗</span>",
          None: "<span title='nothing is demanded'>·</span>"}  # fmt: skip


def draw(figure: Figure) -> bytes:
    """One figure of a study as PNG."""
    with matplotlib.rc_context(PNG_STYLE | _FIGURES):  # type: ignore[arg-type,unused-ignore]
        canvas = Canvas(figsize=(11.0, 6.2), dpi=100, layout="constrained")
        FigureCanvasAgg(canvas)
        figure.draw(canvas)
        file = io.BytesIO()
        canvas.savefig(file, format="png")
    return file.getvalue()


def page(name: str, reproduction: Reproduction, parts: Sequence[Part], seeds: int, quick: bool) -> str:
    """The page.

    Parameters
    ----------
    name : key of `reproduce.STUDIES`
    reproduction : its title and what it is
    parts : what the chapters gave
    seeds, quick : as they were run

    Returns
    -------
    str
    """
    rows = [r for part in parts for r in part.rows]
    aimed = [r for r in rows if r.target is not None and r.ok is not None]
    bad = [r for r in aimed if not r.ok]
    targets = sorted({r.target for r in aimed if r.target is not None})
    whole = len(targets) - len({r.target for r in bad})
    cards = [
        (f"{len(aimed) - len(bad)} of {len(aimed)}", "rows with a target that reach it"),
        (f"{whole} of {len(targets)}", "targets reached in every row"),
        (str(len(rows)), "rows in all"),
        (str(seeds), reproduction.unit + (", quick" if quick else "")),
    ]
    word, kind = ("every target reached", "passed") if not bad else (f"{len(bad)} row{'s' * (len(bad) > 1)} missed", "failed")
    parts_html = [
        "<!DOCTYPE html><html lang=en><head><meta charset=utf-8><meta name=viewport content='width=device-width, initial-scale=1'>",
        f"<title>{_text(reproduction.title)} - RIINS reproduction</title><style>{STYLE}{_MORE}</style></head><body><main>",
        f"<div class=top><div><h1>{_text(reproduction.title)}</h1><p>{_text(reproduction.about)}</p>",
        f"<p>Made by <code>riins reproduce {_text(name)} --seeds {seeds}{' --quick' * quick}</code>.</p></div>",
        f"<div class='badge {kind}'>{word}</div></div>",
        "<div class=cards>" + "".join(f"<div class=card><b>{_text(v)}</b><span>{_text(w)}</span></div>" for v, w in cards) + "</div>",
        f"<section><h2>How to read it</h2><p>{_text(_READING[reproduction.beside])}</p></section>",
    ]
    if bad:
        parts_html.append(
            "<section class=failures><h2>What is missed</h2><ul>" + "".join(f"<li>{_text(_sentence(r))}</li>" for r in bad) + "</ul></section>"
        )
    parts_html.append("<nav>" + "".join(f"<a href=#chapter-{i}>{_text(p.chapter.title)}</a>" for i, p in enumerate(parts)) + "</nav>")
    parts_html += [_table(i, part, reproduction.beside) for i, part in enumerate(parts)]
    for part in parts:
        if part.figures:
            parts_html.append(f"<h2 class=chapter>{_text(part.chapter.title)}: figures</h2>")
        for figure in part.figures:
            data = base64.b64encode(figure.png).decode()
            image = f"<img alt='{_text(figure.title)}' src='data:image/png;base64,{data}'>"
            parts_html.append(f"<section id='{_text(figure.name)}'><h2>{_text(figure.title)}</h2>{image}</section>")
    parts_html.append(f"<footer>{_text(_FOOTER)}</footer></main></body></html>")
    return "".join(parts_html)


def number(value: str | float | None) -> str:
    """A value in four digits, as one reads it, ready for the page."""
    if value is None:
        return ""
    if isinstance(value, str):
        return _text(value)
    if not math.isfinite(value):
        return "∞" if value == math.inf else "-"
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return f"{value:.1e}"


def _table(index: int, part: Part, beside: str) -> str:
    columns = ("target", "", "what", beside, "ours", "5 %", "95 %", "n")
    head = "".join(f"<th{' class=number' if c in columns[3:] else ''}>{c}</th>" for c in columns)
    lines = "".join(_line(r) for r in part.rows)
    title = _text(part.chapter.title)
    return f"<section id=chapter-{index}><h2>{title}</h2><div class=wide><table><tr>{head}</tr>{lines}</table></div></section>"


def _line(row: Row) -> str:
    remark = f"<small>{_text(row.remark)}</small>" if row.remark else ""
    one = row.n <= 1  # a single value has no spread
    cells = [number(row.paper), f"<b>{number(row.value)}</b>", "" if one else number(row.p05), "" if one else number(row.p95), str(row.n)]
    missed = " class=missed" if row.target is not None and row.ok is False else ""
    target = "" if row.target is None else str(row.target)
    start = f"<tr{missed}><td>{target}</td><td class=mark>{_MARKS[row.ok]}</td><td>{_text(row.name)}{remark}</td>"
    return start + "".join(f"<td class=number>{c}</td>" for c in cells) + "</tr>"


def _sentence(row: Row) -> str:
    spread = f" (5-95 %: {number(row.p05)} .. {number(row.p95)}, n = {row.n})" if row.n > 1 else ""
    return f"Target {row.target}, {row.name}: {number(row.value)}{spread}" + (f"; {row.remark}" if row.remark else "")


def _text(text: str) -> str:
    return html.escape(text)
