"""The Python code of the README, compared with its stated output; test_commands.py runs the commands."""

import re
from pathlib import Path

import pytest

README = Path(__file__).resolve().parents[1] / "README.md"


def test_the_readme_code_prints_the_stated_output(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = README.read_text()
    code = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    promised = re.search(r"This prints `(.*?)`", text)
    assert code is not None and promised is not None
    monkeypatch.chdir(README.parent)
    exec(compile(code[1], "README.md", "exec"), {})
    assert capsys.readouterr().out.strip() == promised[1]
