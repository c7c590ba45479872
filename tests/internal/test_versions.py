"""One quick job for each part of the library that depends on compiled or frequently changing packages."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import resgrid as rg

SCENE = Path(__file__).parents[2] / "examples" / "scenes" / "lesson.toml"


def test_a_planned_path_is_certified_and_reaches_the_goal() -> None:
    path = rg.plan(rg.read_scene(SCENE)).path((0.5, 6.5))
    rg.certify(path)
    assert path.outcome is rg.Outcome.REACHED


def test_direct_and_multigrid_solutions_agree() -> None:
    cell = np.zeros((40, 40), dtype=np.uint8)
    cell[10:20, 10:20], cell[30, 30] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    space = rg.ConfigurationSpace([rg.Axis(name, 0.0, 40.0, 40) for name in "xy"], cell)
    netlist = rg.compile_space(space)
    direct, multigrid = (rg.solve(netlist, method=method) for method in ("direct", "multigrid"))
    np.testing.assert_allclose(multigrid.voltage, direct.voltage, rtol=0.0, atol=1e-6)


def test_a_deck_is_written_read_and_solved(tmp_path: Path) -> None:
    netlist = rg.Netlist(3, [[1, 2], [2, 0]], [1.0, 1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    rg.write_spice(rg.solve(netlist), tmp_path / "divider.cir")
    voltage = rg.solve(rg.read_spice(tmp_path / "divider.cir")).voltage
    np.testing.assert_allclose(np.sort(voltage), [0.0, 0.5, 1.0], atol=1e-9)


def test_a_field_is_drawn(tmp_path: Path) -> None:
    field = rg.plan(rg.read_scene(SCENE)).field
    rg.draw(field).figure.savefig(tmp_path / "field.png")
    assert (tmp_path / "field.png").stat().st_size > 1000
