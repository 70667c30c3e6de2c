"""The heading kept between runs, for a hot start: a small YAML file.

Lives here: `read_heading`, `write_heading`.
Does not live here: when it is written and read (nodes/align_action.py), what is made of it (alignment_hot_start.py).
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import yaml


def read_heading(path: str | Path) -> tuple[tuple[float, float] | None, str]:
    """Heading and sigma of a file.

    Parameters
    ----------
    path : file that `write_heading` has written

    Returns
    -------
    (heading, sigma) in rad, or None, and one line on what was found
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        heading, sigma = float(content["heading_deg"]), float(content["sigma_deg"])
    except OSError as error:
        return None, f"no saved heading: {path}: {error.strerror or error}"
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError):
        return None, f"no saved heading: {path} does not hold heading_deg and sigma_deg"
    if not (abs(heading) <= 360.0 and 0.0 < sigma <= 90.0):  # NaN is neither
        return None, f"no saved heading: {path} holds heading_deg {heading:g} (-360 .. 360 is wanted) and sigma_deg {sigma:g} (0 .. 90, not 0)"
    return (math.radians(heading), math.radians(sigma)), f"saved heading {heading:.2f} deg, 1 sigma {sigma:.3f}, of {path}"


def write_heading(path: str | Path, heading: float, sigma: float, stamp_ns: int) -> str:
    """Keep a heading and its sigma, rad; whole or not at all. '' or one line why not."""
    path = Path(path)
    text = yaml.safe_dump({"heading_deg": math.degrees(heading), "sigma_deg": math.degrees(sigma), "stamp_ns": stamp_ns})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        return f"the heading cannot be kept in {path}: {error.strerror or error}"
    return ""
