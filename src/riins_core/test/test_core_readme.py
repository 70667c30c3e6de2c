"""The example of the README runs and prints what the README says."""

import re
from pathlib import Path

import pytest

README = Path(__file__).resolve().parents[1] / "README.md"


@pytest.mark.skipif(not README.exists(), reason="README.md is not installed beside the tests")
def test_readme_example(capsys):
    code = re.search(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)[1]
    promised = re.search(r"# (-?\d+ m)", code)[1]
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith(promised)
