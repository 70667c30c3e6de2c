"""Figures as plotly panels inside one self-contained page, and the page around them.

Lives here: `page`.
Does not live here: what is drawn (plots.py), the numbers (score.py).
"""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from .figure import INK, STATE_COLORS, Figure, Panel

STYLE = """
:root { --ink: #1f2937; --muted: #6b7280; --line: #e5e7eb; --ground: #f8fafc; --good: #047857; --bad: #b91c1c; --accent: #0072b2 }
* { box-sizing: border-box }
body { margin: 0; background: var(--ground); color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif }
main { max-width: 1180px; margin: 0 auto; padding: 28px 20px 60px }
h1 { font-size: 28px; margin: 0 0 4px; letter-spacing: -.01em } h2 { font-size: 19px; margin: 0 0 2px }
p { margin: 0 0 10px; color: var(--muted); max-width: 75ch }
.top { display: flex; flex-wrap: wrap; justify-content: space-between; align-items: flex-start; gap: 12px 24px; margin-bottom: 16px }
.badge { padding: 5px 14px; border-radius: 999px; font-weight: 600; color: #fff; white-space: nowrap; background: var(--muted) }
.badge.passed { background: var(--good) } .badge.failed { background: var(--bad) }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 12px; margin: 0 0 16px }
section, .card { background: #fff; border: 1px solid var(--line); border-radius: 10px }
.card { padding: 12px 16px } .card b { display: block; font-size: 24px; font-variant-numeric: tabular-nums }
.card span { color: var(--muted); font-size: 13px }
.card small { font-size: 14px; font-weight: 500; color: var(--muted) }
section { padding: 18px 20px; margin: 0 0 16px } .failures li { color: var(--bad) } ul { margin: 6px 0 0; padding-left: 20px }
.wide { overflow-x: auto } table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums }
th { text-align: left; font-weight: 600; font-size: 13px; color: var(--muted) }
td, th { padding: 6px 14px 6px 0; border-bottom: 1px solid var(--line); vertical-align: top } tr:last-child td { border-bottom: 0 }
td.number { text-align: right; white-space: nowrap } td.unit { color: var(--muted); width: 30% } .no { color: var(--bad); font-weight: 600 }
.two { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 16px }
nav { margin: 0 0 16px; display: flex; flex-wrap: wrap; gap: 4px 16px }
nav a { color: var(--accent); text-decoration: none } nav a:hover { text-decoration: underline }
footer { color: var(--muted); font-size: 13px } @media print { body { background: #fff } section { break-inside: avoid } nav { display: none } }
"""


def page(
    title: str,
    description: str,
    facts: str,
    passed: bool | None,
    failures: Sequence[str],
    cards: Sequence[tuple[str, str, str]],
    numbers: Sequence[tuple[str, str, str]],
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]],
    notes: Sequence[str],
    figures: Sequence[Figure],
    score: Mapping[str, Any],
) -> str:
    """The report as one HTML document that needs nothing else.

    Parameters
    ----------
    title, description, facts : heading, sentence under it, line of facts (duration, start)
    passed : verdict against the scenario's expectations; None: it has none
    failures : what does not hold
    cards : (value, unit, what) of the most important numbers
    numbers : (what, value, unit) of all numbers
    tables : further tables (heading, column names, rows)
    notes : sentences the reader must know
    figures : of `plots.figures`
    score : embedded as JSON for machines

    Returns
    -------
    str
    """
    word = {None: "no expectations", True: "as expected", False: "not as expected"}[passed]
    kind = {None: "", True: " passed", False: " failed"}[passed]
    parts = [
        "<!DOCTYPE html><html lang=en><head><meta charset=utf-8><meta name=viewport content='width=device-width, initial-scale=1'>",
        f"<title>{_text(title)} - RIINS report</title><style>{STYLE}</style>",
        f"<script>{get_plotlyjs()}</script></head><body><main>",
        f"<div class=top><div><h1>{_text(title)}</h1><p>{_text(description)}</p><p>{_text(facts)}</p></div>",
        f"<div class='badge{kind}'>{word}</div></div>",
        "<div class=cards>"
        + "".join(f"<div class=card><b>{_text(v)} <small>{_text(u)}</small></b><span>{_text(w)}</span></div>" for v, u, w in cards)
        + "</div>",
    ]
    if failures:
        parts.append(
            "<section class=failures><h2>What does not hold</h2><ul>" + "".join(f"<li>{_text(f)}</li>" for f in failures) + "</ul></section>"
        )
    if notes:
        parts.append("<section><h2>To know</h2><ul>" + "".join(f"<li>{_text(n)}</li>" for n in notes) + "</ul></section>")
    parts.append("<nav><a href=#numbers>Numbers</a>" + "".join(f"<a href=#{f.key}>{_text(f.title)}</a>" for f in figures) + "</nav>")
    for heading, columns, rows in tables:
        parts.append(f"<section><h2>{_text(heading)}</h2><div class=wide><table><tr>" + "".join(f"<th>{_text(c)}</th>" for c in columns) + "</tr>")
        parts.append("".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in rows) + "</table></div></section>")
    parts.append("<section id=numbers><h2>Numbers</h2><div class=wide><table>")
    parts.append("".join(f"<tr><td>{_text(w)}</td><td class=number>{_text(v)}</td><td class=unit>{_text(u)}</td></tr>" for w, v, u in numbers))
    parts.append("</table></div></section>")
    for figure in figures:
        parts.append(f"<section id={figure.key}><h2>{_text(figure.title)}</h2><p>{_text(figure.caption)}</p>{_plot(figure)}</section>")
    data = json.dumps(score, allow_nan=False).replace("<", "\\u003c")
    parts.append(f"<script type='application/json' id=score>{data}</script>")
    parts.append("<footer>Errors are computed minus true. Written by RIINS; this page needs no network.</footer></main></body></html>")
    return "".join(parts)


def _cell(text: str) -> str:
    return f"<td class=no>{_text(text)}</td>" if text == "no" else f"<td>{_text(text)}</td>"


def _text(text: str) -> str:
    return html.escape(str(text))


def _plot(figure: Figure) -> str:
    heights = [figure.height for _ in figure.panels]
    margin = {"l": 70, "r": 12, "t": 34, "b": 46}
    rows = len(figure.panels)
    gap = 0.0 if rows == 1 else min(0.06, 0.9 / (rows - 1))
    canvas = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=gap)
    for row, panel in enumerate(figure.panels, start=1):
        _panel(canvas, row, panel, figure)
    canvas.update_layout(
        template="plotly_white", height=sum(heights) + margin["t"] + margin["b"], margin=margin, barmode="overlay", bargap=0.2, hovermode="closest",
        font={"family": 'system-ui, "Segoe UI", Roboto, Arial, sans-serif', "size": 12, "color": INK},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0, "tracegroupgap": 0, "itemsizing": "constant"},
    )  # fmt: skip
    if figure.x_range:
        canvas.update_xaxes(range=list(figure.x_range))
    canvas.update_xaxes(title_text=figure.x_label, row=rows, col=1)
    canvas.update_xaxes(showline=True, linecolor="#9ca3af", gridcolor="#eef0f3", zeroline=False)
    canvas.update_yaxes(gridcolor="#eef0f3", zeroline=False, title_standoff=6)
    if figure.equal:
        canvas.update_yaxes(scaleanchor="x", scaleratio=1)
    config = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["lasso2d", "select2d", "autoScale2d"]}
    return str(canvas.to_html(full_html=False, include_plotlyjs=False, config=config, div_id=f"plot_{figure.key}"))


def _panel(canvas: go.Figure, row: int, panel: Panel, figure: Figure) -> None:
    for band in panel.bands:
        fill = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "legendgroup": band.name}
        canvas.add_trace(go.Scatter(x=band.x, y=band.low, showlegend=False, **fill), row=row, col=1)
        canvas.add_trace(
            go.Scatter(x=band.x, y=band.high, name=band.name, fill="tonexty", fillcolor=_faint(band.color), showlegend=band.legend, **fill),
            row=row,
            col=1,
        )
    for trace in panel.traces:
        dots = trace.style in ("dots", "crosses")
        canvas.add_trace(
            go.Scatter(
                x=trace.x, y=trace.y, name=trace.name, mode="markers" if dots else "lines", showlegend=trace.legend, legendgroup=trace.name,
                marker={"color": trace.color, "size": 3.5 if trace.style == "dots" else 7, "symbol": "circle" if trace.style == "dots" else "x-thin",
                        "line": {"color": trace.color, "width": 0 if trace.style == "dots" else 1.6}} if dots else None,
                line=None if dots else {"color": trace.color, "width": trace.width, "dash": "dash" if trace.style == "dash" else "solid"},
                hovertemplate="%{x:.6g}, %{y:.6g}<extra>" + trace.name + "</extra>",
            ), row=row, col=1,
        )  # fmt: skip
    for level, shade in _levels(panel):
        canvas.add_vrect(x0=shade.start, x1=shade.stop, fillcolor="#f59e0b", opacity=0.13, line_width=0, row=row, col=1)
        if row > 1:
            continue
        canvas.add_annotation(
            x=shade.start, y=1.0 - 0.1 * level, yref=f"y{'' if row == 1 else row} domain", xref=f"x{'' if row == 1 else row}", text=shade.label,
            showarrow=False, xanchor="left", yanchor="top", font={"size": 10, "color": "#92400e"},
        )  # fmt: skip
    if panel.rows:
        _timeline(canvas, row, panel)
    canvas.update_yaxes(title_text=panel.label, row=row, col=1)
    if panel.log:
        canvas.update_yaxes(type="log", dtick=1, row=row, col=1)
    if panel.y_range:
        limits = [math.log10(v) for v in panel.y_range] if panel.log else list(panel.y_range)
        canvas.update_yaxes(range=limits, row=row, col=1)


def _timeline(canvas: go.Figure, row: int, panel: Panel) -> None:
    names = {r: r.replace("_", " ") for r in panel.rows}
    for state, color in [*STATE_COLORS.items(), ("fault", INK)]:
        bars = [b for b in panel.bars if b.state == state]
        if not bars:
            continue
        thin = state == "fault"
        canvas.add_trace(
            go.Bar(
                y=[names[b.row] for b in bars], x=[b.stop - b.start for b in bars], base=[b.start for b in bars], orientation="h",
                name="fault in force" if thin else state,
                marker={"color": color, "line": {"width": 0}}, width=0.1 if thin else 0.68, offset=-0.46 if thin else -0.32,
                customdata=[b.stop for b in bars], hovertemplate="%{y}: %{base:.6g} to %{customdata:.6g}<extra>" + state + "</extra>",
            ), row=row, col=1,
        )  # fmt: skip
    order = [names[r] for r in reversed(panel.rows)]
    canvas.update_yaxes(categoryorder="array", categoryarray=order, range=[-0.7, len(order) - 0.3], row=row, col=1)


def _levels(panel: Panel) -> list[tuple[int, Any]]:
    placed: list[Any] = []
    result = []
    for shade in sorted(panel.shades, key=lambda s: s.start):
        result.append((min(6, sum(1 for other in placed if other.stop > shade.start)), shade))
        placed.append(shade)
    return result


def _faint(color: str) -> str:
    r, g, b = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},0.15)"
