"""What is left of the memory, of the machine and of a container.

Tests internals: `resgrid._internal`.
"""

from pathlib import Path

import numpy as np
import pytest
from support.cli import ROOM, call

import resgrid as rg
from resgrid._internal import memory


def container(folder: Path, limit: str, current: int, inactive: int) -> None:
    (folder / "memory.max").write_text(f"{limit}\n")
    (folder / "memory.current").write_text(f"{current}\n")
    (folder / "memory.stat").write_text(f"anon {current - inactive}\ninactive_file {inactive}\n")


def test_a_container_leaves_its_limit_less_what_is_taken_and_not_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "_GROUP", tmp_path)
    monkeypatch.setattr(memory, "_meminfo_available", lambda: 10_000)
    assert memory.available_memory() == 10_000  # no container
    container(tmp_path, "4000", 3000, 500)
    assert memory.available_memory() == 1500
    container(tmp_path, "4000", 4500, 100)
    assert memory.available_memory() == 0
    container(tmp_path, "400000", 3000, 0)
    assert memory.available_memory() == 10_000  # of the machine
    container(tmp_path, "max", 3000, 0)
    assert memory.available_memory() == 10_000


def test_a_space_that_will_not_fit_is_refused_with_the_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_memory", lambda: 2**30)
    cells = np.broadcast_to(np.uint8(0), (400, 400, 400))
    space = rg.ConfigurationSpace([rg.Axis(name, 0, 400, 400) for name in "zyx"], cells)
    with pytest.raises(rg.BudgetError, match=r"= 6.4e\+07 cells needs about 14\.3 GiB, but 1 GiB is free"):
        rg.compile_space(space)


@pytest.mark.parametrize("verb", ["solve", "path"])
def test_a_grid_is_refused_before_it_is_cut_into_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    scene = tmp_path / "room.toml"
    scene.write_text(ROOM)
    monkeypatch.setattr(memory, "available_memory", lambda: 4000)  # enough for 30 cells, but not for their netlist
    monkeypatch.setattr("resgrid.build_space", lambda *_, **__: pytest.fail("it was cut into cells"))
    result = call(verb, scene)
    assert result.exit_code == 4
    assert "compiling the grid: 6 x 5 = 30 cells needs about" in result.stderr
