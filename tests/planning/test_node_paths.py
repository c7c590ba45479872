"""Paths from node to node: outcomes, certificates, exact geometry, blends, and refusals of what needs cell faces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from core.test_lattices import lattice_spaces, obstacles_of
from hypothesis import assume, given, settings, strategies as st
from shapely import LineString
from support.spaces import serpentine, space_of

import resgrid as rg

LESSON = Path(__file__).parents[2] / "examples" / "scenes" / "lesson.toml"
LATTICES = ("square8", "cube26", "hexagonal")
BOUNDARIES = [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 2e4}]


def room() -> rg.ConfigurationSpace:
    cell = np.zeros((16, 12))
    cell[5, :9], cell[10, 4:], cell[14, 9] = 1, 1, 2
    return space_of(cell, spacing=(0.5, 0.4))


def solved(space: rg.ConfigurationSpace, lattice: str, **options: Any) -> rg.planning.LatticeField:
    try:
        return rg.planning.lattice_field(rg.solve(rg.compile_space(space, lattice=lattice, **options)))
    except rg.CircuitError:
        assume(False)
        raise


@settings(max_examples=25, deadline=None)
@given(st.data())
@pytest.mark.slow
def test_every_start_has_a_certified_path_exactly_if_its_cell_has_one(data: st.DataObject) -> None:
    lattice = data.draw(st.sampled_from(LATTICES))
    space = data.draw(lattice_spaces(lattice))
    planner = rg.plan(space, lattice=lattice, **data.draw(st.sampled_from(BOUNDARIES)))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    solid = obstacles_of(space) if space.ndim == 2 else []
    for cell in np.ndindex(*space.shape):
        start = space.lower + (np.array(cell) + rng.uniform(0.01, 0.99, space.ndim)) * space.spacing
        path = planner.path(start)
        rg.certify(path)
        flows = planner.field.is_flowing
        if space.cell[cell] == rg.Cell.FREE and space.goal_connected[cell] and flows:
            assert path.outcome is rg.Outcome.REACHED
            rg.certify_collision_free(path)
            line = LineString(path.line) if len(path.line) > 1 else None
            assert not any(line.distance(cell) == 0 for cell in solid if line is not None and within_one_turn(path))
        elif space.cell[cell] == rg.Cell.OBSTACLE:
            assert path.outcome is rg.Outcome.START_BLOCKED
        elif space.cell[cell] == rg.Cell.FREE and not space.goal_connected[cell]:
            assert path.outcome in {rg.Outcome.NO_PATH, rg.Outcome.GOAL_BLOCKED}


def within_one_turn(path: rg.planning.NodePath) -> bool:
    """Return whether a path leaves the grid by at most one turn, as far as the copies of obstacles reach."""
    space = path.space
    size = space.upper - space.lower
    return bool(np.all((path.line > space.lower - size) & (path.line < space.upper + size)))


@pytest.mark.parametrize("lattice", ["square8", "hexagonal"])
@pytest.mark.parametrize("options", BOUNDARIES)
@pytest.mark.parametrize("read_out", ["current", "density"])
def test_a_path_follows_the_largest_current_of_every_node(lattice: str, options: Any, read_out: Any) -> None:
    netlist = rg.compile_space(room(), lattice=lattice, **options)
    op = rg.solve(netlist)
    path = rg.planning.node_path(rg.planning.lattice_field(op, read_out=read_out), cell=(0, 0))
    rg.certify(path)
    found, amps = netlist.lattice_map, op.resistor_current
    nodes = found.node[tuple(path.nodes.T)]
    assert len(nodes) > 10 and np.all(np.diff(op.voltage[nodes]) < 0)
    if read_out == "density":  # current over conductance and length is the slope of the voltage
        lengths = np.linalg.norm(found.lattice.steps, axis=1)
        amps = amps / (netlist.conductance * lengths[found.resistor_step])
    for here, there in zip(nodes[:-1].tolist(), nodes[1:].tolist(), strict=True):
        outward = np.where(netlist.resistor_nodes[:, 0] == here, amps, -np.inf)
        outward = np.where(netlist.resistor_nodes[:, 1] == here, -amps, outward)
        joins = np.isin(netlist.resistor_nodes, [here, there]).all(axis=1)
        assert outward[joins].max() == pytest.approx(outward.max(), rel=1e-6)


def test_flat_fields_are_read_from_the_drop() -> None:
    space = space_of(serpentine(9, 40, 2))
    for lattice in ("square8", "hexagonal"):
        field = solved(space, lattice)
        assert np.count_nonzero(field.potential[field.lattice.at_sites(space.goal_connected)] == 1.0) > 100
        cell = np.argwhere(space.goal_connected)[-1].tolist()
        path = rg.planning.node_path(field, cell=cell)
        rg.certify(path)
        assert path.outcome is rg.Outcome.REACHED and path.length > 300


@pytest.mark.parametrize("lattice", ["square8", "hexagonal"])
def test_blends_lie_between_their_halves(lattice: str) -> None:
    planner = rg.plan(room(), k=0.5, lattice=lattice)
    for k in (0.0, 0.3, 0.9, 1.0):
        path = planner.at(k).path((0.3, 0.3))
        rg.certify(path)
        assert path.outcome is rg.Outcome.REACHED and path.field.k == k
    halves = planner.obstacle_field.potential, planner.open_field.potential
    known = np.isfinite(planner.at(0.3).field.potential)
    np.testing.assert_allclose(planner.at(0.3).field.potential[known], (0.3 * halves[0] + 0.7 * halves[1])[known])
    with pytest.raises(rg.InputError, match="0 <= k <= 1"):
        planner.at(1.5)


def test_a_start_may_drive_a_lattice() -> None:
    for lattice in ("square8", "hexagonal"):
        field = solved(room(), lattice, boundary="neumann", drive="start", start=(1, 1))
        path = rg.planning.node_path(field, cell=(1, 1))
        rg.certify(path)
        assert path.outcome is rg.Outcome.REACHED
        assert field.potential[tuple(path.nodes[0])] == 1.0


def test_a_certificate_finds_every_changed_number() -> None:
    for lattice in ("square8", "hexagonal"):
        path = rg.plan(room(), lattice=lattice).path((0.3, 0.3))
        rg.certify(path)
        moved = path.line.copy()
        moved[5, 0] += 1e-3
        skipped = [*range(4), *range(5, len(path.nodes))]
        first = len(path.line) - len(path.nodes)
        direction = [part.copy() for part in path.field.step_direction]
        for part in direction:
            part[tuple(path.nodes[3])] = 0
            part[tuple(path.nodes[4])] = 0
        wrong = {
            "length": replace(path, length=path.length * 1.01),
            "clearance": replace(path, clearance=path.clearance + 0.1),
            "goal": replace(path, goal=1),
            "site": replace(path, line=moved),
            "neighbour": replace(
                path, nodes=path.nodes[skipped], cells=path.cells[skipped],
                line=np.delete(path.line, first + 4, axis=0),
            ),
            "current": replace(path, field=replace(path.field, step_direction=tuple(direction))),
            "outcome": replace(path, outcome=rg.Outcome.NO_CURRENT, goal=None),
        }  # fmt: skip
        for name, changed in wrong.items():
            with pytest.raises(rg.CertificateError):
                rg.certify(changed)
                raise AssertionError(name)
        space = path.space
        cell = space.cell.copy()
        cell[tuple(path.cells[6])] = rg.Cell.OBSTACLE
        for place in (path.cells[6], path.cells[7] if lattice == "square8" else path.cells[6]):
            cell = space.cell.copy()
            cell[tuple(place)] = rg.Cell.OBSTACLE
            other = replace(path.field, lattice=replace(path.field.lattice, space=space.with_cells(cell)))
            with pytest.raises(rg.CertificateError):
                rg.certify(replace(path, field=other))


def test_a_diagonal_past_a_new_obstacle_fails_the_certificate() -> None:
    cell = np.zeros((5, 5))
    cell[4, 4] = 2
    path = rg.plan(space_of(cell), lattice="square8").path((0.5, 0.5))
    rg.certify(path)
    assert len(path.nodes) == 5  # along the diagonal
    cell[2, 3] = 1
    lattice = replace(path.field.lattice, space=space_of(cell))
    with pytest.raises(rg.CertificateError, match=r"touches cell \(2, 3\)"):
        rg.certify(replace(path, field=replace(path.field, lattice=lattice)))


def test_paths_are_shortened_timed_and_saved(tmp_path: Any) -> None:
    path = rg.plan(room(), lattice="square8").path((0.3, 0.3))
    short = rg.shortcut(path)
    assert short.length < path.length and short.original is path
    timed = rg.time_parameterize(short, velocity_limits=1.0)
    for value in (path, short, timed):
        columns, first = rg.save(value, tmp_path / "path.csv").read_text().splitlines()[:2]
        assert columns.startswith("path,k,outcome,") and first.startswith("0,1.0,reached,")
    with np.load(rg.save(path.field, tmp_path / "field.npz")) as arrays:
        assert {name: array.shape for name, array in arrays.items()} == {
            "potential": (16, 12), "log_drop": (16, 12), "cell": (16, 12), "points": (16, 12, 2)
        }  # fmt: skip
        np.testing.assert_allclose(arrays["points"][3, 2], (1.75, 1.0))


def test_an_update_solves_the_lattice_again() -> None:
    planner = rg.plan(room(), lattice="hexagonal").update(cells=[(1, 1)], values=rg.Cell.OBSTACLE)
    assert planner.replanning.method == "fresh" and "lattice" in planner.replanning.reason
    rg.certify(planner.path((0.3, 0.3)))
    assert planner.path((0.75, 0.6)).outcome is rg.Outcome.START_BLOCKED


def test_ends_are_those_of_paths() -> None:
    planner = rg.plan(room(), lattice="hexagonal")
    starts = [(0.3, 0.3), (2.6, 0.5), (7.1, 3.7), (7.7, 4.5)]
    ends, paths = planner.ends(starts), planner.paths(starts)
    assert ends.outcome.tolist() == [str(path.outcome) for path in paths]
    assert ends.goal.tolist() == [-1 if path.goal is None else path.goal for path in paths]
    for length, path in zip(ends.length, paths, strict=True):
        assert length == path.length or (np.isnan(length) and path.goal is None)


def refused(name: str, planner: rg.planning.Planner) -> Any:
    """Return the result of a function that needs currents through cell faces, or cells of a netlist."""
    field, path, space = planner.field, planner.path((0.3, 0.3)), planner.space
    netlist = rg.compile_space(space, lattice="square8")
    scene = rg.read_scene(LESSON).replace(lattice="square8")
    calls = {
        "streamline": lambda: rg.streamline(field, (0.3, 0.3)),
        "streamlines": lambda: rg.streamlines(field, [(0.3, 0.3)]),
        "basins": lambda: rg.basins(field),
        "blend": lambda: rg.blend(field, field, 0.5),
        "field": lambda: rg.field(rg.solve(netlist)),
        "share": lambda: rg.plan(space, lattice="square8", k=0.5).dirichlet_fraction(),
        "clearance_curve": lambda: rg.planning.clearance_curve(planner, wall_resistances=(1e3, 1e4)),
        "random_walk": lambda: rg.planning.random_walk(netlist),
        "controller": lambda: rg.control.make_controller(field),
        "simulation": lambda: rg.simulation(scene),
        "study": lambda: rg.study(scene),
        "study of a space": lambda: rg.study(space, lattice="square8"),
        "board": lambda: rg.hardware.build_board(scene),
        "layout": lambda: rg.hardware.build_layout(space, "ihp-sg13g2:rppd", lattice="square8"),
        "warm start": lambda: rg.circuit.WarmStart(lattice="square8").solve(space),
        "petsc": lambda: rg.plan(space, lattice="square8", method="petsc"),
        "tiles": lambda: rg.write_spice(rg.solve(netlist), "tiles.cir", form="cells"),
        "switches": lambda: rg.chip.build_chip(netlist, rg.Chip(goal_switch_on=100.0)),
        "node_path": lambda: rg.planning.node_path(rg.plan(space).field, (0.3, 0.3)),
        "draw currents": lambda: rg.draw(field, quantity="currents"),
    }
    del path
    return calls[name]()


REFUSED = (
    "streamline", "streamlines", "basins", "blend", "field", "share", "clearance_curve", "random_walk", "controller",
    "simulation", "study", "study of a space", "board", "layout", "warm start", "petsc", "tiles", "switches",
    "node_path", "draw currents",
)  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_function_that_needs_cell_faces_rejects_a_lattice(name: str, tmp_path: Any, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    planner = rg.plan(room(), lattice="square8")
    with pytest.raises(rg.InputError, match=r"[Ll]attice|quantity is not an option"):
        refused(name, planner)


@pytest.mark.parametrize("lattice", ["square8", "hexagonal"])
@pytest.mark.parametrize(("lower", "width"), [(5e6, 0.05), (-1e6, 1e-3)])
def test_paths_far_from_the_origin_have_certificates(lattice: str, lower: float, width: float) -> None:
    cell = np.where(np.random.default_rng(0).random((9, 10)) < 0.25, rg.Cell.OBSTACLE, rg.Cell.FREE)
    cell[3, 4] = rg.Cell.GOAL
    axes = [rg.Axis(name, lower, lower + n * width, n) for name, n in zip("xy", cell.shape, strict=True)]
    planner = rg.plan(rg.ConfigurationSpace(axes, cell), lattice=lattice)
    for path in planner.paths(planner.space.centre(np.argwhere(planner.space.goal_connected))):
        rg.certify(path)
        assert path.outcome is rg.Outcome.REACHED
