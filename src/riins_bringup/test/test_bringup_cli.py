"""The command line: help with examples, exit status, one-line errors, no heavy import before a verb runs.

Lives here: tests of riins_bringup.cli without running nodes.
Does not live here: `riins up` (test/ at top level), the work behind the verbs (their packages).
"""

from __future__ import annotations

import json
import subprocess
import sys
import types

import numpy as np
import pytest

from riins_bringup.cli import main

VERBS = ["geometry", "sail", "navigate", "score", "report", "up", "import", "reproduce", "demo", "bag info", "bag recover", "bag play"]


@pytest.mark.parametrize("verb", ["", "bag", *VERBS])
def test_help_at_every_level_has_an_example(verb, capsys):
    assert main([*verb.split(), "--help"]) == 0
    assert "Example" in capsys.readouterr().out


def test_help_keeps_units_and_names_every_study(capsys):
    """Square brackets are markup to the printer of help; the studies stand in the help by hand, because it must not import them."""
    from riins_eval.reproduce import STUDIES

    for words in (["up"], ["demo"], ["bag", "play"]):
        assert main([*words, "--help"]) == 0
        assert "[s]" in capsys.readouterr().out, words
    assert main(["reproduce", "--help"]) == 0
    text = capsys.readouterr().out
    assert not [name for name in STUDIES if name not in text]


def test_help_imports_nothing_heavy():
    code = (
        "import sys, riins_bringup.cli as c; c.main(['--help']); print([m for m in ('numpy', 'scipy', 'numba', 'rclpy', 'yaml') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["saill"], "sail"),
        (["geometry", "--jason", "x"], "--json"),
        (["up"], "SCENARIO or --bag"),
        (["up", "harbour", "--bag", "x"], "SCENARIO or --bag"),
        (["up", "harbour", "--rate", "fast"], "rate"),
        (["up", "harbour", "--rate", "0"], "rate"),
        (["up", "harbor"], "harbour"),
        (["up", "harbour", "--record", "."], "exists already"),
        (["bag", "info", "/no/such/bag"], "/no/such/bag"),
        (["geometry", "/no/such/file"], "/no/such/file"),
        (["sail", "harbour", "--record", "nav"], "--out"),
        (["up", "harbour", "--namespace", "a b"], "'a b'"),
        (["bag", "play", "x", "--namespace", "1st"], "'1st'"),
        (["up", "harbour", "--nmea", "udp://a..b:10110"], "\"nmea\": udp://a..b:10110: the host 'a..b' is not known"),
        (["up", "harbour", "--record", "/proc/no/bag"], "cannot write /proc/no/bag"),
        (["up", "harbour", "--json", "/proc/no/file"], "cannot write /proc/no/file"),
        (["sail", "harbour", "--json", "."], "cannot write ."),
        (["sail", "a" * 300], "File name too long"),
        (["sail", "harbour", "--out", "a" * 300], "File name too long"),
        (["sail", "harbour", "--seed", str(2**31)], "--seed"),
        (["report", "bag", "--out", "/dev/null/page"], "cannot write /dev/null/page"),
        (["up", "harbour", "--logs", "/dev/null"], "cannot write /dev/null"),
        (["up", "harbour", "--nmea", ","], "names no address"),
        (["reproduce", "thesiss"], '"thesis"'),
        (["reproduce", "thesis", "--out", "/dev/null"], "/dev/null"),
        (["reproduce", "thesis", "--seeds", "0"], "--seeds"),
        (["navigate", "bag", "--out", "again", "--align", "none"], "--align wants a method"),
    ],
)
def test_bad_use_is_one_line_and_status_2(words, message, capsys):
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith("riins: error: ") and error.count("\n") == 1 and message in error


def test_a_full_disk_is_one_line_and_a_bad_result(capsys):
    assert main(["geometry", "--json", "/dev/full"]) == 1
    assert capsys.readouterr().err == "riins: error: /dev/full: No space left on device\n"


def test_a_study_without_its_recordings_is_no_success(tmp_path, capsys):
    assert main(["reproduce", "real", "--quick", "--data", str(tmp_path), "--out", str(tmp_path / "page")]) == 2
    assert "skipped" in capsys.readouterr().out


def test_options_that_are_no_text_are_bad_use(tmp_path, capsys):
    path = tmp_path / "binary.png"
    path.write_bytes(b"\x89PNG\r\n")
    assert main(["import", "x.npz", "--out", str(tmp_path / "bag"), "--options", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "binary.png" in error
    path.write_text("name: 2020-13-45")
    assert main(["import", "x.npz", "--out", str(tmp_path / "bag"), "--options", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "month must be in 1..12" in error


def test_trying_a_target_leaves_nothing_and_takes_nothing(tmp_path, capsys):
    old = tmp_path / "old.json"
    old.write_text("kept")
    words = ["up", "harbor", "--record", str(tmp_path / "a/b/bag"), "--json"]
    assert main([*words, str(tmp_path / "c/figures.json")]) == main([*words, str(old)]) == 2
    assert "harbour" in capsys.readouterr().err  # past the targets, to the scenario
    assert [p.name for p in tmp_path.iterdir()] == ["old.json"] and old.read_text() == "kept"


def test_an_interrupted_verb_says_so_and_leaves_no_bag(tmp_path, monkeypatch, capsys):
    from riins_eval import offline

    def interrupted(voyage, writer, progress):
        writer.configuration("name: half", 1)
        raise KeyboardInterrupt

    monkeypatch.setattr(offline._Voyage, "run", interrupted)
    assert main(["sail", "harbour", "--out", str(tmp_path / "bag")]) == 1
    assert capsys.readouterr().err == "riins: error: interrupted\n" and not (tmp_path / "bag").exists()


def test_an_interrupt_that_an_import_turns_into_another_error_is_one_line():
    code = (
        "import os, signal, sys, riins_bringup.cli as cli, riins_bringup.__main__ as entry\n"
        "def main():\n"
        "    try: os.kill(os.getpid(), signal.SIGINT); signal.sigtimedwait([], 5)\n"
        "    except KeyboardInterrupt: raise RuntimeError('calling __set_name__')\n"
        "cli.main = main; sys.exit(entry.run())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "riins: error: interrupted\n")


@pytest.mark.parametrize(("epochs", "status"), [(0, 1), (1, 0)])
def test_a_run_of_which_nothing_was_scored_is_a_bad_result(tmp_path, monkeypatch, capsys, epochs, status):
    from riins_bringup import printing
    from riins_eval import offline

    result = types.SimpleNamespace(score={"epochs": epochs, "faults": [], "notes": []}, expect={})
    monkeypatch.setattr(offline, "navigate", lambda *_, **__: result)
    monkeypatch.setattr(printing, "score_table", lambda _: "")
    figures = tmp_path / "figures.json"
    assert main(["navigate", "bag", "--out", str(tmp_path / "again"), "--json", str(figures)]) == status
    assert ("no epoch could be scored" in capsys.readouterr().out) == (status == 1)
    assert json.loads(figures.read_text())["verdict"]["passed"] == (status == 0)
    result.score |= {"epochs": 0, "scored": "sensors", "alignment": {"aligned": False}}
    assert main(["navigate", "bag", "--out", str(tmp_path / "again"), "--align", "auto"]) == 1
    assert "did not end in a state" in capsys.readouterr().out


def test_scenario_with_a_typo_names_line_and_cure(tmp_path, capsys):
    path = tmp_path / "typo.yaml"
    path.write_text("name: typo\nduration_s: 20.0\nstart: {latitude_deg: 1.0, longitude_deg: 2.0, sped_kn: 5.0}\n")
    assert main(["up", str(path)]) == 2
    error = capsys.readouterr().err
    assert "typo.yaml:3" in error and "speed_kn" in error and error.count("\n") == 1


def test_geometry_of_the_thesis(capsys, tmp_path):
    assert main(["geometry", "--json", str(tmp_path / "g.json")]) == 0
    out = capsys.readouterr().out
    assert "35.2644" in out and "31.7175" in out and "0.4472*" in out
    figures = json.loads((tmp_path / "g.json").read_text())
    assert figures["table_2_1"]["3"][3] == pytest.approx({"n": 6, "theta": 2.85, "delta": 0.5, "figure": 0.475})
    assert figures["isolation"]["orthogonal"][2]["gdop"] is None  # both sensors of one axis gone: no solution


def test_geometry_of_a_file(tmp_path, capsys):
    path = tmp_path / "axes.txt"
    path.write_text("# forward, starboard, down\n1 0 0\n0, 1, 0\n0 0 1\n0.57735026919 0.57735026919 0.57735026919\n")
    assert main(["geometry", str(path), "--survivors", "4", "--json", str(tmp_path / "g.json")]) == 0
    assert "4 sensors" in capsys.readouterr().out
    figures = json.loads((tmp_path / "g.json").read_text())
    assert figures["coherence"] == pytest.approx(3.0**-0.5)
    assert figures["reliability"] == {"4": {"theta": 0.75, "figure": 0.1875}}
    one = figures["isolation"][1]
    assert one["sigma_worst"] == pytest.approx((3.0 + 6.0**0.5) ** 0.5) and one["alike"] == 3 and one["sensors"] == [0]  # an axis, not the diagonal
    for text, message in (("1 0 0\n0 1 0\n", "3 <= n"), ("1 0 0\n0 1 0\n0 0 2\n", "sensor 3"), ("1 0 0\n0 1\n0 0 1\n", "row 2"), ("a 0 c\n", "a")):
        path.write_text(text)
        assert main(["geometry", str(path)]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and message in error and "axes.txt" in error
    assert main(["geometry", "--survivors", "2"]) == 2
    assert "3 to 64" in capsys.readouterr().err


def test_geometry_files_of_every_kind(tmp_path, capsys):
    from riins_bringup.geometry_file import read_geometry
    from riins_core.imu_array import dodecahedron

    axes = dodecahedron()
    rows = axes.tolist()
    (tmp_path / "a.csv").write_text("x,y,z\n" + "\n".join(",".join(map(str, row)) for row in rows))
    (tmp_path / "b.yaml").write_text(json.dumps(rows))
    (tmp_path / "c.yml").write_text("rate_hz: 100\ngeometry: " + json.dumps(rows))
    np.savez(tmp_path / "d.npz", t=np.zeros(7), mounting=axes)
    np.savez(tmp_path / "e.npz", H=axes, other=np.zeros((4, 3)))
    np.save(tmp_path / "f.npy", axes)
    for name in ("a.csv", "b.yaml", "c.yml", "d.npz", "e.npz", "f.npy"):
        np.testing.assert_allclose(read_geometry(tmp_path / name).H, axes, atol=1e-15)
    np.savez(tmp_path / "g.npz", a=axes, b=axes)
    np.save(tmp_path / "h.npy", axes.T)
    np.save(tmp_path / "o.npy", np.array([{}], dtype=object))
    (tmp_path / "i.npz").write_text("no archive")
    (tmp_path / "j.yaml").write_text("axes: [[1, 0, 0], [0, 1, 0], [0, 0, x]]")
    (tmp_path / "k.yaml").write_text("axes: {a: 1}")
    (tmp_path / "l.yaml").write_text("- [1, 0\n")
    (tmp_path / "m.csv").write_bytes(b"\xff\xfe\x00")
    for name in ("g.npz", "h.npy", "i.npz", "j.yaml", "k.yaml", "l.yaml", "m.csv", "o.npy"):
        assert main(["geometry", str(tmp_path / name)]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and name in error


def test_geometry_is_drawn_with_the_lost_axis_named(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda canvas, path, **_: drawn.append(canvas))
    assert main(["geometry", "--plot", str(tmp_path / "g.png")]) == 0
    axes = drawn[0].axes
    assert len(axes) == 9
    assert [len(a.lines) for a in axes] == [4] * 6 + [3] * 3 and "orthogonal" in axes[6].get_xlabel()
    np.testing.assert_allclose(axes[0].lines[0].get_ydata(), 0.5**0.5, rtol=1e-12)  # six sensors evenly: the same everywhere
    assert axes[6].lines[0].get_ydata().max() <= 1.345  # no direction is worse than the table says


@pytest.mark.parametrize(("ok", "status"), [(True, 0), (False, 1), (None, 0)])
def test_reproduce_says_what_is_missed(tmp_path, monkeypatch, capsys, ok, status):
    from riins_eval import reproduce
    from riins_eval.studies.rows import Row

    def run(seeds, quick, progress):
        progress(1.0)
        return [Row(7, "made up", 0.5, 0.25, 0.2, 0.3, seeds, ok, "")], []

    monkeypatch.setitem(sys.modules, "made_up", types.SimpleNamespace(run=run))
    monkeypatch.setitem(reproduce.STUDIES, "made_up", reproduce.Reproduction("Made up", "", (reproduce.Chapter("made_up", "All"),)))
    page, rows = tmp_path / "out", tmp_path / "rows.json"
    assert main(["reproduce", "made_up", "--seeds", "3", "--out", str(page), "--json", str(rows)]) == status
    assert json.loads(rows.read_text()) == json.loads((page / "rows.json").read_text())
    assert json.loads(rows.read_text())[0] == {
        "target": 7, "name": "made up", "paper": 0.5, "value": 0.25, "p05": 0.2, "p95": 0.3, "n": 3, "ok": ok, "remark": "",
    }  # fmt: skip
    out = capsys.readouterr().out
    assert str(page / "index.html") in out and ("target 7 missed: made up: 0.25 (0.2 .. 0.3)" in out) == (status == 1)
