"""Reproductions: the registry, the order and spread of rows, the page, two processes.

Lives here: tests of riins_eval.reproduce and reproduce_page on a made-up study.
Does not live here: the numbers of the real studies (test_eval_thesis_*.py), the verb (riins_bringup).
"""

from __future__ import annotations

import html
import json
import math
import os
import re
import sys
from html.parser import HTMLParser

import pytest

from riins_eval import reproduce as reproduction
from riins_eval.reproduce import Chapter, Reproduction, StudyError, as_json, missed, reproduce
from riins_eval.reproduce_page import number, page
from riins_eval.studies.rows import Row

STUDY = """
import os
from riins_eval.studies.rows import Figure, Row, row
def run(seeds, quick, progress):
    for part in (0.25, 0.5, 1.0):
        progress(part)
    if "{name}" == "breaks":
        raise RuntimeError("the study broke")
    rows = [
        row(7, "{name} <pid>", [float(os.getpid())] * seeds, paper="a & b", ok=lambda r: {ok}, remark="why it <is> so"),
        Row(None, "{name} quick", 1.5, float(quick), float("inf"), float("nan"), 1, None, ""),
    ]
    return rows, [Figure("{name}_line", "a line", lambda canvas: canvas.subplots().plot([0, 1], [1, 0]))]
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    """Register the study `made_up` of two chapters; the second one's row misses its target if asked, or the study breaks."""

    def make(ok="True", second="two"):
        sources = tmp_path / "studies"
        sources.mkdir()
        for name, verdict in (("one", "True"), (second, ok)):
            (sources / f"made_up_{name}.py").write_text(STUDY.format(name=name, ok=verdict))
            monkeypatch.delitem(sys.modules, f"made_up_{name}", raising=False)
        monkeypatch.syspath_prepend(str(sources))
        chapters = (Chapter("made_up_one", "Chapter one"), Chapter(f"made_up_{second}", "Chapter two", 3.0))
        monkeypatch.setitem(reproduction.STUDIES, "made_up", Reproduction("A made-up study", "It is <not> real.", chapters))

    return make


class _Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.seen, self.open = [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_whole_and_names_what_is_missed(study, tmp_path):
    study(ok="False")
    told = []
    rows = reproduce("made_up", seeds=4, out=tmp_path / "page", progress=lambda done, total: told.append(done / total), processes=1)
    assert [r.name for r in rows] == ["one <pid>", "one quick", "two <pid>", "two quick"] and [r.name for r in missed(rows)] == ["two <pid>"]
    assert told == sorted(told) and told[-1] == 1.0 and told[0] == 0.0625
    text = (tmp_path / "page/index.html").read_text(encoding="utf-8")
    tags = _Tags()
    tags.feed(text)
    assert tags.open == []
    images = [attrs["src"] for tag, attrs in tags.seen if tag == "img"]
    assert len(images) == 2 and all(src.startswith("data:image/png;base64,") for src in images)
    assert not re.search(r"""(?:src|href)=['"]?https?:""", text) and "<pid>" not in text and "a &amp; b" in text
    assert text.count("<tr class=missed>") == 1 and "1 row missed" in text and "why it &lt;is&gt; so" in text and "1 of 2" in text
    for name in ("one_line", "two_line"):
        assert (tmp_path / f"page/{name}.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "page/rows.json").read_text()) == as_json(rows)


def test_two_processes_give_the_rows_in_the_order_of_the_chapters(study):
    study()
    rows = reproduce("made_up", quick=True, processes=2)
    assert [r.name for r in rows] == ["one <pid>", "one quick", "two <pid>", "two quick"]
    assert os.getpid() not in (rows[0].value, rows[2].value) and [rows[i].n for i in (0, 2)] == [5, 5] and rows[1].value == 1.0


def test_a_study_that_breaks_ends_the_run(study):
    study(second="breaks")
    with pytest.raises(RuntimeError, match="the study broke"):
        reproduce("made_up", processes=2)


def test_unknown_names_no_seeds_and_no_directory_are_refused(tmp_path):
    with pytest.raises(StudyError, match='did you mean "thesis"'):
        reproduce("thsis")
    with pytest.raises(StudyError, match="at least one seed"):
        reproduce("thesis", seeds=0)
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        reproduce("thesis", out=tmp_path / "file", progress=lambda *_: pytest.fail("computed before it looked"))


def test_json_has_null_for_what_is_not_finite():
    (entry,) = as_json([Row(3, "x", "0.5", 1.0, -math.inf, math.nan, 2, True, "")])
    assert entry == {"target": 3, "name": "x", "paper": "0.5", "value": 1.0, "p05": None, "p95": None, "n": 2, "ok": True, "remark": ""}


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (0.01234567, "0.01235"), (99999.4, "99999"), (1.5e-16, "1.5e-16"), (math.inf, "∞"), ("<", "&lt;"), (None, "")]
)
def test_numbers_as_one_reads_them(value, text):
    assert number(value) == text


def test_chapter_2_of_the_thesis_makes_a_page(tmp_path, monkeypatch):
    thesis = reproduction.STUDIES["thesis"]
    monkeypatch.setitem(reproduction.STUDIES, "thesis", Reproduction(thesis.title, thesis.about, thesis.chapters[:1]))
    rows = reproduce("thesis", quick=True, out=tmp_path)
    assert not missed(rows) and {r.target for r in rows} == {1, None} and (tmp_path / "index.html").stat().st_size > 100_000


@pytest.mark.parametrize("name", reproduction.STUDIES)
def test_every_study_can_be_written_as_a_page(name):
    study = reproduction.STUDIES[name]
    parts = [reproduction.Part(chapter, (Row(None, "a number", None, 1.0, 1.0, 1.0, 1, None, ""),), ()) for chapter in study.chapters]
    text = page(name, study, parts, 3, True)
    assert all(html.escape(chapter.title) in text for chapter in study.chapters)
