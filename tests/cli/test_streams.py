"""Standard streams of real processes: closed descriptors, and a file at its size limit as standard output.

Tests internals: `resgrid.io.tables`.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.cli import COMMAND

from resgrid.io import tables

LIMIT = 4096
"""Size limit of written files, in bytes."""


LIMITED = ["sh", "-c", f'ulimit -f {LIMIT // 512}; exec "$@"', "sh"]
"""Start of a command line in which a write beyond the limit fails as on a full disk: Python ignores SIGXFSZ."""


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("words", [("compile",), ("path", "--json"), ("path", "-o", "-"), ("plot", "-o", "-")])
@pytest.mark.quick_cases(4)
def test_a_truncated_standard_output_exits_with_2(scenes, tmp_path, words, unbuffered):
    command, *options = words
    choice = ["--boundary", "dirichlet"] if command == "compile" else ["--k", "1"]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered, "PYTHONDONTWRITEBYTECODE": "1"}  # it would be truncated
    line = [*COMMAND, command, str(scenes / "rooms.toml"), *choice, *options]
    whole = subprocess.run(line, capture_output=True, check=True, env=environment).stdout  # also caches the kernels
    written = tmp_path / "written"
    with written.open("wb") as file:
        done = subprocess.run(
            [*LIMITED, *line], stdout=file, stderr=subprocess.PIPE, text=True, check=False, env=environment
        )
    assert written.read_bytes() == whole[:LIMIT] != whole
    assert (done.returncode, done.stderr.count("\n")) == (2, 1) and "File too large" in done.stderr


def test_emit_writes_all_bytes_to_an_unbuffered_stream(monkeypatch, tmp_path):
    class Short(io.FileIO):
        """File that writes at most 7 bytes at a time."""

        def write(self, data):
            return super().write(memoryview(data)[:7])

    with Short(tmp_path / "whole", "w") as raw:
        monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, write_through=True))
        tables.emit("-", bytes(range(100)))
        assert (tmp_path / "whole").read_bytes() == bytes(range(100))


@pytest.mark.parametrize("closed", [(2,), (1, 2), (0, 1, 2)])
@pytest.mark.quick_cases(1)
def test_a_command_without_standard_streams_writes_its_files(scenes, tmp_path, closed):
    shell = " ".join(f"{number}>&-" for number in closed)
    words = [*COMMAND, "path", str(scenes / "lesson.toml"), "-o", "path.csv"]
    done = subprocess.run(["sh", "-c", f'exec "$@" {shell}', "sh", *words], check=False, cwd=tmp_path)
    assert done.returncode == 0
    assert [file.name for file in tmp_path.iterdir()] == ["path.csv"]


def test_a_closed_standard_input_has_one_message():
    words = ["sh", "-c", 'exec "$@" <&-', "sh", *COMMAND, "path", "-"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "resgrid: error: standard input is closed; give the name of a file, or pipe one\n"


def test_files_do_not_get_the_descriptors_of_closed_streams(tmp_path):
    """A child process would write its messages to a file with the descriptor of standard error."""
    script = (
        "import os\nfrom resgrid.cli.streams import prepare_streams\nprepare_streams()\n"
        "number = os.open('file', os.O_CREAT)\nopen('number', 'w').write(str(number))"
    )
    words = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", sys.executable, "-c", script]
    subprocess.run(words, check=True, cwd=tmp_path)
    assert int(Path(tmp_path, "number").read_text()) > 2


def test_a_full_disk_of_compiled_kernels_names_the_variable_of_their_folder(scenes, tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    words = [*LIMITED, *COMMAND, "path", str(scenes / "lesson.toml"), "-q"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "compiled kernels cannot be stored: File too large" in done.stderr and "NUMBA_CACHE_DIR" in done.stderr
