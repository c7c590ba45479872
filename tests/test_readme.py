"""The README's Python and commands run as written, and print what the README says."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.cli import call

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


def test_the_commands_for_a_map_of_one_s_own_run_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.full((20, 28), 254, dtype=np.uint8)
    rows[5:15, 12:14] = 0
    Image.fromarray(rows).save(tmp_path / "room.png")
    keys = "resolution: 0.5\norigin: [-7, -5, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    (tmp_path / "map.yaml").write_text(f"image: room.png\n{keys}")
    lines = re.findall(r"^\$ resgrid (\S+ map\.yaml[^#\n]*)", README.read_text(), re.MULTILINE)
    assert [line.split()[0] for line in lines] == ["info", "plot", "run"]
    monkeypatch.chdir(tmp_path)
    for line in lines:
        result = call(*shlex.split(line))
        assert result.exit_code == 0, f"{line}: {result.stderr}"
    assert "goal 0" in result.stdout
