"""What a study hands back: rows of numbers beside the paper's, and figures that can be drawn.

Lives here: `Row`, `Figure`, `row`, which makes a row from one value a seed, and the type of a progress callback.
Does not live here: any study (the other modules of this package), the page made of the rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Progress = Callable[[float], None]
"""Told the part of a study that is done, 0..1."""


@dataclasses.dataclass(frozen=True)
class Row:
    """One number of a study beside the paper's.

    `target` is the number in the table of targets or None; `value` the mean (or the one value), `p05` and `p95` its spread over
    `n` seeds; `ok` whether it reaches what is demanded, None where nothing is demanded; `remark` a sentence where a claim does not hold and why.
    """

    target: int | None
    name: str
    paper: str | float | None
    value: float
    p05: float
    p95: float
    n: int
    ok: bool | None
    remark: str


@dataclasses.dataclass(frozen=True)
class Figure:
    """One figure: `draw(canvas)` fills an empty matplotlib figure; `name` is good as a file name."""

    name: str
    title: str
    draw: Callable[[Any], None]


def row(
    target: int | None,
    name: str,
    values: ArrayLike,
    *,
    paper: str | float | None = None,
    ok: Callable[[Row], bool] | None = None,
    centre: Callable[[Any], Any] = np.mean,
    remark: str = "",
) -> Row:
    """A row from one value a seed: its centre (the mean unless told), 5th and 95th percentile, and the verdict of `ok` on that row."""
    samples = np.atleast_1d(np.asarray(values, float))
    low, high = np.percentile(samples, (5.0, 95.0))
    made = Row(target, name, paper, float(centre(samples)), float(low), float(high), len(samples), None, remark)
    return made if ok is None else dataclasses.replace(made, ok=bool(ok(made)))
