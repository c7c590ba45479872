"""Commands shown in pages, docstrings, help, scenes and the live page, run as shown in this process.

Tests internals: `resgrid.cli`, `resgrid.cli.entry`, `resgrid.live_page.launch`, `resgrid.scene.overrides`,
`resgrid.viewer.launch`.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import zlib
from base64 import urlsafe_b64encode
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import Result
from PIL import Image
from support.cli import call
from support.shown import PROJECT, Piece, fragments, helps, pages, runs_resgrid, sources, words_of

import resgrid as rg
from resgrid.cli import main
from resgrid.cli.entry import SUBCOMMANDS
from resgrid.live_page.launch import LivePage
from resgrid.scene.overrides import document_of
from resgrid.viewer.launch import Viewer

ELSEWHERE = {
    "srun resgrid chip chip.toml --only yield --most 1000000 --executor mpi -o report": "needs Slurm",
    "mpiexec -n 3 resgrid chip examples/scenes/chip.toml --only yield --no-check --executor mpi -o mpi -q":
        "needs MPI; tests/cli/test_cli_executors.py runs it",
    "resgrid chip examples/scenes/chip.toml --only yield --no-check --executor dask://127.0.0.1:8799 -o dask -q":
        "needs a scheduler at a fixed port; tests/cli/test_cli_executors.py runs it at a free one",
    "resgrid chip examples/scenes/chip.toml --only yield --no-check --executor processes:2 -o two -q":
        "starts processes; tests/cli/test_cli_executors.py runs it",
    "resgrid chip chip.toml --only yield --at-least 0.95 --executor processes":
        "starts processes; tests/cli/test_cli_executors.py runs it",
    "resgrid solve map.yaml --goal 5,0 --boundary neumann --method petsc --ranks 2 -o field.npz":
        "needs PETSc; tests/planning/test_petsc.py runs it",
    'resgrid solve map.yaml --goal 5,0 --method petsc --launcher "srun -n 64" -o field.npz':
        "needs PETSc and Slurm; tests/planning/test_petsc.py runs another launcher",
    "resgrid check board/grid.kicad_pcb": "needs a board; tests/hardware/test_board_check.py runs it",
    "resgrid check chip.gds": "needs a layout; tests/hardware/test_layouts.py runs it",
}  # fmt: skip
"""Shown commands that are not run here, with the reason."""

ALSO = {
    "run": ["--no-check"],
    "chip": ["--most=8", "--seconds=0.1", "--no-check"],
    "board": ["--no-kicad"],
    "live": ["--no-browser", "--port=0"],
}
"""Options that make a command shorter and leave the simulator, the browser and fixed ports alone."""

CODES = {"resgrid chip examples/scenes/chip.toml --only yield -o report": (0, 1)}
"""Exit codes of shown commands, if not 0; any code is accepted in lines with ``||``."""

STANDS_FOR = {"SCENE": "lesson.toml", "MAP": "map.yaml", "DECK": "theirs.sp", "FILE": "file.npz"}
DECK = "a ladder\nv1 vdd 0 1.8\nr1 vdd a 10\nr2 a b 10\nrload b 0 1k\n.op\n.end\n"
SCEN = "version 1\n0\tarena.map\t8\t8\t0\t0\t7\t7\t9.9\n0\tarena.map\t8\t8\t0\t7\t7\t7\t7.0\n"


def _link() -> str:
    """Return a link of the live page, in quotes."""
    content = zlib.compress(json.dumps(document_of(rg.read_scene("lesson"))).encode())
    return f"'http://127.0.0.1:8017/#s={urlsafe_b64encode(content).decode().rstrip('=')}'"


def _map(folder: Path) -> None:
    """Write a ROS map: a room of 14 x 10 m around the origin, with a wall."""
    rows = np.full((20, 28), 254, dtype=np.uint8)
    rows[5:15, 12:14] = 0
    Image.fromarray(rows).save(folder / "room.png")  # a shown command writes map.png
    keys = "resolution: 0.5\norigin: [-7, -5, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    (folder / "map.yaml").write_text(f"image: room.png\n{keys}")


def _recording(folder: Path) -> None:
    """Write a recording of an empty room of 14 x 10 m around the origin, with three maps."""
    pytest.importorskip("rosbags", reason="rosbags reads recordings; it is in the extra 'bags'")
    rows, place = np.zeros((20, 28)), (-6.2, -4.2, 0.0)
    maps = [rg.maps.MapSnapshot(rows, 0.5, (-7.0, -5.0, 0.0), start=place, received=second) for second in range(3)]
    rg.maps.write_bag(maps, folder / "in.mcap")


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files of the shown commands; shipped scenes are found by name."""
    _map(tmp_path)
    _recording(tmp_path)
    (tmp_path / "examples").symlink_to(PROJECT / "examples")
    for name in ("theirs.sp", "power_grid.sp"):
        (tmp_path / name).write_text(DECK)
    (tmp_path / "arena.map").write_text("type octile\nheight 8\nwidth 8\nmap\n" + "........\n" * 8)
    (tmp_path / "arena.map.scen").write_text(SCEN)
    small = (PROJECT / "examples" / "scenes" / "rooms.toml").read_text().replace("cells = 160", "cells = 80")
    (tmp_path / "rooms.toml").write_text(small.replace("cells = 120", "cells = 60"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "3")
    monkeypatch.setattr("resgrid.cli.control.FRAMES", 6)
    monkeypatch.setattr(LivePage, "wait", lambda _page: None)
    monkeypatch.setattr(Viewer, "wait", lambda _page: None)
    monkeypatch.setattr("resgrid.cli.live.is_computing", lambda **_words: False)  # the interrupt would end this process
    return tmp_path


def _run(piece: Piece, line: str) -> Result | None:
    """Run a shown line, or check the options of a line without an input."""
    text = os.path.expandvars(line)
    for word, file in STANDS_FOR.items():
        text = re.sub(rf"\b{word}\b(?!\.)", file, text)
    if "LINK" in text:
        text = text.replace("LINK", _link())
    subcommand, *words = words_of(text)
    command = main.get_command(click.Context(main), subcommand)  # type: ignore[attr-defined]
    assert command is not None, f"{piece.place}: {line}: there is no {subcommand}"
    known = {name for option in command.params for name in (*option.opts, *option.secondary_opts)} | {"--help", "-h"}
    given = [word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)]
    unknown = [word for word in given if word not in known]
    assert not unknown, f"{piece.place}: {line}: {subcommand} has no {unknown}"
    if _is_mention(command, subcommand, words):
        return None
    also = [option for option in ALSO.get(subcommand, []) if option.partition("=")[0] not in given]
    result = call(subcommand, *words, *also)
    codes = CODES.get(line, (0,))
    assert "||" in line or result.exit_code in codes, f"{piece.place}: {line}: {result.stdout[-500:]}{result.stderr}"
    return result


def _is_mention(command: click.Command, subcommand: str, words: list[str]) -> bool:
    """Return whether a command in running text only names a subcommand or an option."""
    if subcommand == "live" or (subcommand == "info" and words):
        return False
    try:
        with command.make_context(subcommand, list(words)):
            return subcommand == "info"
    except click.MissingParameter:
        return True
    except click.BadOptionUsage:  # an option whose value is not shown
        return words[-1].startswith("-")


def _lines(piece: Piece) -> Iterator[tuple[str, bool]]:
    """Yield the lines of a piece, and whether they are commands of resgrid."""
    for line in piece.text.replace("\\\n", " ").splitlines():
        yield line.strip(), runs_resgrid(line)


def _run_all(pieces: list[Piece]) -> None:
    """Run pieces in order: commands in this process, other lines in a shell."""
    for piece in pieces:
        if piece.kind == "python":
            if re.search(r"write_text\(|\.save\(|np\.save|write_bag\(", piece.text):
                exec(compile(piece.text, piece.place, "exec"), {"__name__": "page"})
            continue
        lines = list(_lines(piece))
        if any(line in ELSEWHERE for line, _ in lines):
            continue
        others: list[str] = []
        for line, is_ours in [*lines, ("", True)]:
            if not is_ours:
                others.append(line)
                continue
            if others:
                subprocess.run(["bash", "-e", "-c", "\n".join(others)], check=True, stdout=subprocess.DEVNULL)
                others = []
            if line:
                _run(piece, line)


PAGES = pages()
SLOW = {
    "board",
    "check",
    "chip",
    "control",
    "plot",
    "run",
    "README.md",
    "docs/explanation/energy.md",
    "docs/howto/board.md",
    "docs/howto/cluster.md",
    "docs/howto/good_enough.md",
    "docs/howto/install.md",
    "docs/howto/layout.md",
    "docs/howto/urdf.md",
    "docs/howto/verify_hardware.md",
    "docs/howto/voxel_maps.md",
    "docs/index.md",
    "docs/live.md",
    "docs/reference/files.md",
}
"""Subcommands whose examples, and pages whose commands, take more than two seconds."""


def slow_marked(names: Iterable[str]) -> list[Any]:
    """Return the names as parameters, those in `SLOW` with the mark `slow`."""
    return [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in names]


@pytest.mark.parametrize("place", slow_marked(PAGES))
@pytest.mark.quick_cases(6)
def test_commands_of_a_page_run_in_order(place: str, desk: Path) -> None:
    last = max(number for number, piece in enumerate(PAGES[place]) if piece.kind != "python")
    _run_all(PAGES[place][: last + 1])


@pytest.mark.slow
def test_commands_of_docstrings_scenes_and_the_live_page_run(desk: Path) -> None:
    _run_all(sources())


@pytest.mark.parametrize("subcommand", slow_marked(SUBCOMMANDS))
@pytest.mark.quick_cases(3)
def test_examples_of_help_run(subcommand: str, desk: Path) -> None:
    if subcommand == "check":  # decks that the examples of other commands write
        for name in ("rooms.cir", "ours.cir"):
            assert call("compile", "rooms.toml", "--boundary=dirichlet", "-o", name).exit_code == 0
    _run_all(helps(subcommand))


def test_every_exempted_command_is_still_shown() -> None:
    shown = [piece for pieces in PAGES.values() for piece in pieces] + sources()
    shown += [piece for subcommand in SUBCOMMANDS for piece in helps(subcommand)]
    lines = {line for piece in shown if piece.kind != "python" for line, _ in _lines(piece)}
    assert set(ELSEWHERE) | set(CODES) <= lines


@pytest.mark.parametrize("place", sorted({place for place, _ in fragments()}))
def test_options_in_running_text_exist(place: str) -> None:
    commands = [main.get_command(click.Context(main), subcommand) for subcommand in SUBCOMMANDS]  # type: ignore[attr-defined]
    known = {
        name for command in commands for option in command.params for name in (*option.opts, *option.secondary_opts)
    }
    for where, text in fragments():
        if where == place:
            unknown = [name for name in re.findall(r"(?<![\w-])--[a-z][a-z-]+", text) if name not in known | {"--help"}]
            assert not unknown, f"{place}: `{text}`"


def test_targets_and_scripts_in_running_text_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (PROJECT / "Makefile").read_text(), re.MULTILINE))
    files = [*PROJECT.glob("*.md"), *(PROJECT / "docs").rglob("*.md"), *(PROJECT / "benchmarks").rglob("*.md")]
    for file in files:
        text = file.read_text(encoding="utf-8")
        named = set(re.findall(r"(?:`|^\$ )make ([a-z-]+)\b", text, re.MULTILINE))
        assert named <= targets, file
        scripts = set(re.findall(r"\bscripts/[\w.]+\.(?:sh|py)\b", text))
        assert all((PROJECT / script).is_file() for script in scripts), file
