"""The README's Python runs as written, and prints what the README says; its commands: test_commands.py."""

import re
from pathlib import Path

import pytest

README = Path(__file__).resolve().parents[1] / "README.md"


def test_the_ten_lines_print_what_is_promised(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = README.read_text()
    code = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    promised = re.search(r"This prints `(.*?)`", text)
    assert code is not None and promised is not None
    monkeypatch.chdir(README.parent)
    exec(compile(code[1], "README.md", "exec"), {})
    assert capsys.readouterr().out.strip() == promised[1]
