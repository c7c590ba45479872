"""The solve pipeline: planner, control and command line, compared with fields solved and blended by hand.

Tests internals: `resgrid.planning.pipeline`.
"""

from pathlib import Path

import numpy as np
import pytest
from support.cli import ROOM, answer, call

import resgrid as rg
from resgrid.planning.pipeline import problem_of, solve_field, solve_problem


def scene(text: str = "", **changes: object) -> rg.Scene:
    return rg.parse_scene(ROOM.replace("[grid]", f"{text}\n[grid]", 1), "room").replace(**changes)


def assert_same_field(first: rg.Field, second: rg.Field) -> None:
    np.testing.assert_allclose(first.potential, second.potential, rtol=1e-9)
    for one, other in zip(first.face_direction, second.face_direction, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann", "wall"])
@pytest.mark.parametrize("k", [None, 0.0, 0.3, 1.0])
def test_every_entry_point_gives_the_same_field(boundary: str, k: float | None) -> None:
    """At k = 1 obstacles are a rail (behind the wall resistance, if any); at k = 0 they are open."""
    chip = rg.Chip(wall_resistance=2e4) if boundary == "wall" else rg.Chip()
    room = scene(boundary=boundary, k=() if k is None else (k,), chip=chip)
    space = rg.build_space(room)
    closed = {"boundary": "dirichlet" if k is not None and boundary == "neumann" else boundary}
    if closed["boundary"] == "wall":
        closed["wall_resistance"] = 2e4
    pure = [rg.field(rg.solve(rg.compile_space(space, **wired))) for wired in (closed, {"boundary": "neumann"})]
    expected = pure[0] if k is None else rg.blend(*pure, k)
    assert rg.plan(room).k == expected.k
    for field in (
        rg.plan(room).field,
        solve_problem(problem_of(room), scaled=True).fields[0],
        solve_field(space, problem_of(room).wiring, k),
        rg.simulation(room).controller.field,
    ):
        assert_same_field(field, expected)


def test_a_scaled_drive_equals_normalize_drive() -> None:
    room = scene(boundary="neumann", chip=rg.Chip(supply=2.5))
    op = solve_problem(problem_of(room), scaled=True).operating_points["neumann"]
    netlist = rg.compile_space(rg.build_space(room), boundary="neumann", supply=2.5)
    by_hand = rg.solve(rg.normalize_drive(netlist, rg.solve(netlist)))
    np.testing.assert_allclose(op.voltage, by_hand.voltage, rtol=1e-12)
    assert np.nanmax(op.voltage) == pytest.approx(2.5)


def test_every_driving_start_has_its_own_circuit_unless_blocked(tmp_path: Path) -> None:
    file = tmp_path / "room.toml"
    starts = "boundary = 'neumann'\ndrive = 'start'\n[grid]"
    file.write_text(ROOM.replace("[grid]", starts, 1).replace("[5.5, 4.5]", "[4.5, 4.5], [5.5, 4.5], [2.5, 0.5]"))
    solution = solve_problem(problem_of(rg.read_scene(file)))
    assert list(solution.operating_points) == ["neumann_start_0", "neumann_start_3"]
    assert [field.is_flowing for field in solution.fields] == [True, False, False, True]
    reply = answer("path", file, code=1)["paths"]
    assert [path["outcome"] for path in reply] == ["reached", "start_blocked", "no_path", "reached"]
    with pytest.raises(rg.InputError, match="drive = 'uniform'"):
        rg.plan(rg.read_scene(file))


def test_a_flat_dirichlet_half_is_reported_and_k_1_has_no_current(tmp_path: Path) -> None:
    """Without an obstacle, or an edge that counts as one, the Dirichlet half is flat; the other half flows."""
    file = tmp_path / "open.toml"
    begin, _, end = ROOM.partition("[[obstacle]]")
    file.write_text(f"{begin}{end[end.index('[[goal]]') :]}".replace("[grid]", 'k = 0.5\nedge = "open"\n[grid]', 1))
    room = rg.read_scene(file)
    blend, neumann = rg.plan(room), rg.plan(room, k=0.0)
    np.testing.assert_allclose(blend.field.potential, 0.5 * neumann.field.potential, rtol=1e-12)
    np.testing.assert_allclose(blend.path((0.5, 0.5)).points, neumann.path((0.5, 0.5)).points, rtol=1e-9)
    for planner in (blend.at(1.0), rg.plan(room, k=1.0), rg.plan(room, boundary="dirichlet")):
        path = planner.path((0.5, 0.5))
        assert path.outcome is rg.Outcome.NO_CURRENT and "open the obstacles" in str(path.reason)
    result = call("path", file)
    assert result.exit_code == 0 and "dirichlet field of the blend is zero" in result.stderr
    outcomes = [path["outcome"] for path in answer("path", file, "--k", "0.5,1", code=1)["paths"]]
    assert outcomes == ["reached", "reached", "no_current", "no_current"]
