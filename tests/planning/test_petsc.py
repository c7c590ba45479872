"""Method petsc, compared with the built-in solver; launchers, missing tools, and no remaining processes or files.

Tests internals: `resgrid.planning.petsc_fields`, `resgrid.solvers`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import ROOM, call
from support.spaces import space_of

import resgrid as rg
from resgrid.planning.petsc_fields import solve_ranked
from resgrid.solvers import petsc

try:
    petsc.find_petsc()
except rg.ToolMissingError as error:
    pytest.skip(f"{error}", allow_module_level=True)

CASES: list[tuple[tuple[int, ...], tuple[int, ...], dict[str, Any]]] = [
    ((30, 40), (), {}),
    ((30, 40), (0,), {"boundary": "neumann"}),
    ((2, 30), (0, 1), {"boundary": "wall", "wall_resistance": 1e5}),
    ((9, 10, 11), (1,), {"boundary": "wall", "wall_resistance": 3e4, "edge": ["open", "obstacle", "obstacle"]}),
    ((6, 7, 5, 6), (1, 3), {"boundary": "dirichlet"}),
    ((6, 2, 5, 6), (1, 3), {"boundary": "neumann", "edge": "open"}),
]
QUICK = (1, 3)
"""Cases without the mark `slow`: two ranks in the plane and one rank in space."""


def scattered_space(shape: tuple[int, ...], rings: tuple[int, ...], seed: int) -> rg.ConfigurationSpace:
    """A grid with scattered obstacles, two goals, a conductivity, and cells that are not square."""
    rng = np.random.default_rng(seed)
    cell = (rng.random(shape) < 0.2).astype(np.uint8)
    for _ in range(2):
        cell[tuple(rng.integers(0, size) for size in shape)] = rg.Cell.GOAL
    widths = rng.uniform(1, 2, len(shape))
    axes = [rg.Axis("xyzw"[a], 0.0, widths[a] * n, n, periodic=a in rings) for a, n in enumerate(shape)]
    return rg.ConfigurationSpace(axes, cell, conductivity=rng.lognormal(size=shape))


def processes() -> str:
    return subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True).stdout


@pytest.mark.filterwarnings("ignore:more ranks")
@pytest.mark.parametrize(
    "number", [pytest.param(number, marks=[pytest.mark.slow] * (number not in QUICK)) for number in range(len(CASES))]
)
@pytest.mark.quick_cases(1)
def test_petsc_agrees_with_the_built_in_solver_and_safe_paths_certify(number: int) -> None:
    shape, rings, options = CASES[number]
    space = scattered_space(shape, rings, number)
    ours, theirs = (
        rg.plan(space, **options).field,
        rg.plan(space, method="petsc", ranks=number % 3 + 1, **options).field,
    )
    assert theirs.safe is not None
    assert theirs.safe.sum() > 0.9 * space.goal_connected.sum()
    assert not np.any(theirs.safe & ~space.goal_connected)
    np.testing.assert_allclose(theirs.potential, ours.potential, rtol=0, atol=1e-10)
    assert (theirs.log_drop is None) == (ours.log_drop is None)
    for axis in range(space.ndim):
        largest = np.abs(ours.face_current(axis)).max()
        np.testing.assert_allclose(theirs.face_current(axis), ours.face_current(axis), rtol=0, atol=1e-9 * largest)
    for cell in np.argwhere(theirs.safe)[:: max(1, int(theirs.safe.sum()) // 20)]:
        path = rg.streamline(theirs, cell=cell.tolist())
        rg.certify(path)
        assert (path.reason is None) == (path.outcome is rg.Outcome.REACHED)


@pytest.mark.slow
def test_direction_safe_cells_obey_kirchhoffs_current_law() -> None:
    space = scattered_space((40, 30), (0,), 7)
    field = rg.plan(space, method="petsc", boundary="dirichlet", ranks=2).field
    net, through = np.zeros(space.shape), np.zeros(space.shape)
    for axis in range(2):
        current = np.moveaxis(field.face_current(axis), axis, 0)
        net += np.moveaxis(current[:-1] - current[1:], 0, axis)
        through += np.moveaxis(np.abs(current[:-1]) + np.abs(current[1:]), 0, axis) / 2
    assert field.safe is not None and field.safe.any()
    assert np.all(np.abs(net)[field.safe] <= 1.01e-6 * through[field.safe])


@pytest.mark.slow
def test_streamlines_end_in_cells_that_are_not_direction_safe() -> None:
    cell = np.zeros((200, 3), dtype=np.uint8)  # a corridor in which the drop falls below any norm
    cell[0, 1] = rg.Cell.GOAL
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 200, 200), rg.Axis("y", 0, 3, 3)], cell)
    field = rg.plan(space, method="petsc", ranks=1).field
    assert field.safe is not None and field.safe[5, 1]
    beyond = np.argwhere(space.goal_connected & ~field.safe)[-1].tolist()
    near, far = rg.streamline(field, cell=(5, 1)), rg.streamline(field, cell=beyond)
    assert near.outcome is rg.Outcome.REACHED
    assert far.outcome is rg.Outcome.NO_CURRENT and f"not direction-safe from cell {tuple(beyond)}" in str(far.reason)
    rg.certify(near)
    rg.certify(far)
    assert rg.streamlines(field, space.centre([[5, 1], beyond])).outcome.tolist() == ["reached", "no_current"]
    assert rg.basins(field)[tuple(beyond)] == -1


@pytest.mark.slow
def test_a_driving_start_agrees_with_the_built_in_solver() -> None:
    space = scattered_space((20, 20), (), 3)
    start = tuple(np.argwhere(space.goal_connected)[100].tolist())
    from resgrid.core.wiring import Wiring

    wiring = Wiring("neumann", "start", start=start)
    theirs = solve_ranked(space, wiring, 2).field
    ours = rg.field(rg.solve(rg.compile_space(space, wiring)))
    np.testing.assert_allclose(theirs.potential, ours.potential, rtol=0, atol=1e-9)
    path = rg.streamline(theirs, cell=start)
    assert path.outcome is rg.Outcome.REACHED
    rg.certify(path)


@pytest.mark.slow
def test_solve_and_path_accept_method_petsc(tmp_path: Path) -> None:
    scene = tmp_path / "room.toml"
    scene.write_text(ROOM)
    result = call("solve", scene, "--method", "petsc", "--ranks", 2, "-o", tmp_path / "field.npz")
    assert result.exit_code == 0 and "direction-safe" in result.stdout and "2 ranks" in result.stdout
    with np.load(tmp_path / "field.npz") as arrays:
        assert arrays["safe"].shape == arrays["potential"].shape == (6, 5)
    paths = [call("path", scene, "--boundary", "neumann", *words).stdout for words in ((), ("--method", "petsc"))]
    assert paths[0] == paths[1]
    assert call("solve", scene, "--ranks", 2).exit_code == 2


@pytest.mark.slow
def test_a_launcher_replaces_mpiexec_and_sets_the_number_of_ranks(tmp_path: Path) -> None:
    scene = tmp_path / "room.toml"
    scene.write_text(ROOM)
    result = call("solve", scene, "--method", "petsc", "--launcher", "mpiexec -n 2", "--json")
    assert result.exit_code == 0, result.stderr
    data = json.loads(result.stdout)
    assert data["ranks"] == len(data["peak_bytes"]) == 2
    space = scattered_space((12, 10), (), 4)
    by_launcher, by_ranks = (
        rg.plan(space, method="petsc", **options).field for options in ({"launcher": "mpiexec -n 2"}, {"ranks": 2})
    )
    np.testing.assert_array_equal(by_launcher.potential, by_ranks.potential)


@pytest.mark.parametrize(
    ("launcher", "status", "message"),
    [
        ("no-such-launcher -n 2", 3, "there is no program 'no-such-launcher'; correct its name or path"),
        ("", 2, "launcher = '' is empty; give one, such as 'srun -n 64'"),
        ("mpiexec -n '2", 2, "is not a command (No closing quotation); correct its quotes"),
    ],
)
def test_an_invalid_launcher_gives_a_one_line_message(launcher: str, status: int, message: str, tmp_path: Path) -> None:
    scene = tmp_path / "room.toml"
    scene.write_text(ROOM)
    result = call("solve", scene, "--method", "petsc", "--launcher", launcher)
    assert result.exit_code == status
    assert result.stderr.count("\n") == 1 and message in result.stderr and not result.stdout


def test_a_launcher_with_ranks_or_another_method_raises_input_error() -> None:
    space = scattered_space((5, 5), (), 0)
    with pytest.raises(rg.InputError, match="the launcher sets the number of ranks; leave out ranks"):
        rg.plan(space, method="petsc", ranks=2, launcher="mpiexec -n 2")
    with pytest.raises(rg.InputError, match="needs method = 'petsc', not 'auto'"):
        rg.plan(space, launcher="mpiexec -n 2")


@pytest.mark.slow
def test_a_broken_launcher_and_one_without_effect_are_reported(tmp_path: Path) -> None:
    space = scattered_space((5, 5), (), 0)
    launcher = tmp_path / "launcher"
    launcher.write_bytes(b"\0")
    launcher.chmod(0o755)
    with pytest.raises(
        rg.ToolMissingError, match=r"launcher cannot be run \(Exec format error\): correct the launcher"
    ):
        rg.plan(space, method="petsc", launcher=str(launcher))
    with pytest.raises(rg.AccuracyError, match=r"every computer needs the folder .* \(TMPDIR\) and "):
        rg.plan(space, method="petsc", launcher="false")


@pytest.mark.slow
def test_a_launcher_of_another_mpi_is_rejected(tmp_path: Path) -> None:
    launcher = tmp_path / "launcher"  # starts two processes that do not know each other
    launcher.write_text('#!/bin/sh\n"$@"\n"$@"\n')
    launcher.chmod(0o755)
    with pytest.raises(rg.InputError, match=r"another MPI than PETSc \(two of its processes are rank 0 of 1\)"):
        rg.plan(scattered_space((5, 5), (), 0), method="petsc", launcher=str(launcher))


def test_a_missing_petsc_exits_with_3_and_the_install_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tmp_path / "room.toml"
    scene.write_text(ROOM)
    monkeypatch.setenv("RESGRID_PETSC_PYTHON", str(tmp_path / "python3"))
    result = call("solve", scene, "--method", "petsc")
    assert result.exit_code == 3
    assert "apt-get install python3-petsc4py" in result.stderr


def test_the_import_error_of_petsc4py_is_part_of_the_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, says in (("python3", "OSError: libpetsc.so: cannot open shared object file"), ("mpiexec", "")):
        (tmp_path / name).write_text(f"#!/bin/sh\necho '{says}' >&2\nexit 1\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("RESGRID_PETSC_PYTHON", str(tmp_path / "python3"))
    with pytest.raises(rg.ToolMissingError, match=r"cannot import petsc4py \(OSError: libpetsc\.so: cannot open"):
        petsc.find_petsc()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("-pc_type nonsense", "-pc_type nonsense: Unable to find requested PC type nonsense"),
        pytest.param(
            "-pc_type gamg -ksp_max_it abc",
            "-ksp_max_it abc: Input string abc has no integer value",
            marks=pytest.mark.slow,
        ),
        pytest.param("-options_file /nowhere", "-options_file /nowhere: ", marks=pytest.mark.slow),
    ],
)
def test_an_option_that_petsc_rejects_is_named(
    options: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tmp_path / "room.toml"
    scene.write_text(ROOM)
    monkeypatch.setenv("PETSC_OPTIONS", options)
    result = call("solve", scene, "--method", "petsc")
    assert result.exit_code == 2
    assert f"PETSc refuses an option of PETSC_OPTIONS: {said}" in result.stderr


@pytest.mark.slow
def test_excess_ranks_and_unused_petsc_options_cause_warnings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    monkeypatch.setenv("PETSC_OPTIONS", "-pc_typ gamg")
    with pytest.warns(UserWarning) as caught:
        rg.plan(scattered_space((9, 9), (), 1), method="petsc", ranks=2)
    said = " ".join(str(warning.message) for warning in caught)
    assert "more ranks (2) than cores (1)" in said and "no use for -pc_typ of PETSC_OPTIONS" in said


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_an_enclosed_goal_raises_circuit_error_and_blocks_paths(boundary: str) -> None:
    cell = np.zeros((9, 9), dtype=np.uint8)
    cell[3:6, 3:6], cell[4, 4] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    with pytest.raises(rg.CircuitError, match="no free cell is connected to a goal; move the goal"):
        solve_ranked(space_of(cell), rg.Wiring(boundary), ranks=1)
    assert rg.plan(space_of(cell), method="petsc", boundary=boundary).ends([(0.5, 0.5)]).outcome == ["goal_blocked"]


@pytest.mark.parametrize("method", ["auto", "petsc"])
def test_obstacles_without_contact_to_the_goals_component_drive_no_current(method: str) -> None:
    cell = np.array([[1, 0, 1, 2, 0]], dtype=np.uint8).T
    planner = rg.plan(space_of(cell), method=method, edge="open")
    assert not planner.field.is_flowing
    assert planner.path(cell=(4, 0)).outcome is rg.Outcome.NO_CURRENT
    with pytest.raises(rg.CircuitError, match="nothing is driven: no "):
        solve_ranked(space_of(cell), rg.Wiring(edge="open"), ranks=1)


def test_ranks_beyond_the_memory_raise_budget_error() -> None:
    with (
        pytest.warns(UserWarning, match="wait for one another"),
        pytest.raises(rg.BudgetError, match=r"on 100000 ranks needs about .* take fewer ranks"),
    ):
        rg.plan(scattered_space((9, 9), (), 1), method="petsc", ranks=100_000)


def test_rg_solve_with_petsc_names_rg_plan_instead() -> None:
    netlist = rg.compile_space(scattered_space((5, 5), (), 0))
    with pytest.raises(rg.InputError, match=r"rg\.plan\(space, method='petsc'"):
        rg.solve(netlist, method="petsc")


@pytest.mark.slow
def test_a_killed_rank_is_reported_and_ends_the_other_ranks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dying = "import os, signal, sys, time\n"
    dying += "os.environ['OMPI_COMM_WORLD_RANK'] == '1' and os.kill(os.getpid(), signal.SIGKILL)\ntime.sleep(600)\n"
    worker = tmp_path / "dying_worker.py"
    worker.write_text(dying)
    monkeypatch.setattr(petsc, "_WORKER", worker)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(rg.AccuracyError, match="signal 9"):
        rg.plan(scattered_space((9, 9), (), 1), method="petsc", ranks=2)
    assert str(worker) not in processes()
    assert not list(tmp_path.glob("resgrid-*"))


@pytest.mark.slow
def test_an_interrupt_ends_the_ranks_and_removes_the_files(tmp_path: Path) -> None:
    worker = tmp_path / "sleeping_worker.py"
    worker.write_text("import pathlib, sys, time\npathlib.Path(sys.argv[1] + '/../began').touch()\ntime.sleep(600)\n")
    program = tmp_path / "program.py"
    program.write_text(
        "import pathlib\nimport resgrid as rg\nfrom resgrid.solvers import petsc\n"
        f"petsc._WORKER = pathlib.Path({str(worker)!r})\n"
        "space = rg.ConfigurationSpace([rg.Axis('x', 0, 4, 4)], [2, 0, 0, 1])\n"
        "rg.plan(space, method='petsc', ranks=2)\n"
    )
    process = subprocess.Popen(
        [sys.executable, program], env={**os.environ, "TMPDIR": str(tmp_path)}, stderr=subprocess.DEVNULL
    )
    for _ in range(6000):
        if (tmp_path / "began").exists():
            break
        time.sleep(0.05)
    process.send_signal(2)
    process.wait(300)
    assert str(worker) not in processes()
    assert not list(tmp_path.glob("resgrid-*"))
