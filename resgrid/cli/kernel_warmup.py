"""Jobs that call all compiled kernels, so that the kernels' machine code is in the cache before a user needs it.

Numba compiles a kernel at its first call and caches it next to its source (or in ``NUMBA_CACHE_DIR``).  Each job in
`CASES` calls the kernels of one or several methods.  The jobs run in several processes, which share the cached kernels.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import numpy as np

import resgrid as rg
from resgrid.robots.urdf.free_cells import prove_cells
from resgrid.scene.shipped import shipped_scenes


def _axes(**cells: int) -> tuple[rg.Axis, ...]:
    return tuple(rg.Axis(name, 0.0, 8.0, count) for name, count in cells.items())


_ROOM = rg.Scene(
    axes=_axes(x=24, y=24),
    obstacles=(rg.Box((1.0, 4.0), (5.0, 5.0)), rg.Ball((6.5, 6.5), 0.7)),
    hidden=(rg.Ball((2.9, 2.35), 0.3),),
    goals=(rg.GoalPoint((6.5, 1.5)),),
    starts=((0.5, 6.5),),
    chip=rg.Chip(
        capacitance=60e-15, mismatch=0.01, temperature=60.0, tc1=-2e-3,
        readout=rg.chip.Readout(bits=12, noise_bandwidth=1e6),
    ),
)  # fmt: skip

_LINKS = rg.Arm(lengths=(1.0, 1.0), widths=(0.08, 0.08), self_collision=True)
_ARM = rg.Scene(
    axes=_LINKS.axes(32),
    robot=_LINKS,
    obstacles=(rg.Polygon(((0.9, 1.1), (1.3, 1.1), (1.1, 1.4))),),
    goals=(rg.Ball((-1.2, -0.8), 0.2),),
    starts=((1.4, 0.3),),
)

_PLATE = rg.PolygonRobot(((-1.2, -0.4), (1.2, -0.4), (1.2, 0.4), (-1.2, 0.4)))
_TURNING = rg.Scene(
    axes=_PLATE.axes_on_map(_axes(x=16, y=16), headings=8),
    robot=_PLATE,
    obstacles=(rg.Box((3.6, 0.0), (4.4, 3.6)),),
    goals=(rg.Box((6.4, 6.4), (7.2, 7.2)),),
    starts=((2.0, 2.0, 0.0),),
)


def _room(*shape: int, walls: int = 0) -> rg.ConfigurationSpace:
    """Return a space with a goal cell in its last corner, and with a block of obstacle cells or parallel barriers.

    `shape`: number of cells per axis; `walls`: distance between barriers of obstacle cells, in cells; 0 for one block
    near the middle instead of barriers.  Each barrier leaves a passage at one end, at alternating ends for successive
    barriers.
    """
    cell = np.zeros(shape, dtype=np.uint8)
    if walls:
        cell[walls :: 2 * walls, : 1 - walls] = 1
        cell[2 * walls :: 2 * walls, walls - 1 :] = 1
    else:
        cell[tuple(slice(n // 3, n // 2) for n in shape)] = 1
    cell[(-1,) * len(shape)] = 2
    return rg.ConfigurationSpace(tuple(rg.Axis(f"x{i}", 0.0, float(n), n) for i, n in enumerate(shape)), cell)


def _solve(space: rg.ConfigurationSpace, **options: Any) -> rg.OperatingPoint:
    """Return the operating point of a space; `options`: keywords of `rg.compile_space` and `rg.solve`."""
    solving = {name: options.pop(name) for name in ("accuracy", "method") if name in options}
    return rg.solve(rg.compile_space(space, **options), **solving)


def _plane() -> None:
    _solve(_room(256, 256), method="multigrid")


def _plane_of_voltages() -> None:
    _solve(_room(256, 256), method="multigrid", accuracy="normwise")
    _solve(_room(512, 512))


def _open_obstacles() -> None:
    _solve(_room(192, 192), boundary="neumann", method="multigrid")
    _solve(_room(64, 64), boundary="wall", wall_resistance=1e4)


def _volume() -> None:
    _solve(_room(32, 32, 32), method="multigrid")
    _solve(_room(24, 24, 24), boundary="neumann", method="multigrid")
    _solve(_room(24, 24, 24))


def _uneven() -> None:
    space = _room(200, 200)
    uneven = 10.0 ** np.random.default_rng(0).uniform(-1.5, 1.5, space.shape)
    _solve(replace(space, conductivity=uneven), method="multigrid")
    _solve(_room(512, 512, walls=64), method="multigrid")


def _corridors() -> None:
    _solve(_room(64, 64))
    _solve(_room(256, 256, walls=4))
    cell = np.zeros((63, 65), dtype=np.uint8)
    cell[1::2, :] = 1
    cell[1::4, 0] = cell[3::4, -1] = 0
    cell[-1, -1] = 2
    maze = rg.ConfigurationSpace((rg.Axis("x", 0, 63, 63), rg.Axis("y", 0, 65, 65)), cell)
    _solve(maze)
    _solve(maze, accuracy="normwise")


def _netlist(nodes: int, per_node: float = 3.0) -> rg.Netlist:
    """Return a netlist of resistors between random nodes, some of them in parallel, and one voltage source.

    `nodes`: number of nodes; `per_node`: approximate number of resistors per node.
    """
    pick = np.random.default_rng(0)
    ends = pick.integers(1, nodes, (int(nodes * per_node), 2))
    ends = ends[ends[:, 0] != ends[:, 1]]
    ends = np.concatenate([ends, np.stack([np.arange(1, nodes - 1), np.arange(2, nodes)], axis=1), [[1, 0]]])
    return rg.Netlist(
        node_count=nodes,
        resistor_nodes=ends.astype(np.int32),
        conductance=10.0 ** pick.uniform(-6, -4, len(ends)),
        source_nodes=np.array([[nodes - 1, 0]], dtype=np.int32),
        source_volts=np.ones(1),
    )


def _irregular() -> None:
    netlist = _netlist(20_000)
    rg.solve(netlist, method="multigrid")
    _ = rg.solve(netlist, method="multigrid", accuracy="normwise").power
    rg.solve(_netlist(3000), method="direct")
    rg.solve(_netlist(1000, 0.2))
    rg.effective_resistance(_netlist(1000), terminals=range(1, 40))


def _paths() -> None:
    planner = rg.plan(_ROOM, k=0.5)
    path = planner.path((0.5, 6.5))
    rg.certify(path)
    rg.shortcut(path)
    field = planner.field
    assert isinstance(field, rg.Field)
    rg.basins(field)
    rg.streamlines(field, [(0.5, 6.5), (7.5, 7.5)])


def _updates() -> None:
    for planner in (rg.plan(_room(40, 40), k=0.5), rg.plan(_room(120, 50, walls=2))):
        planner.update(cells=[(0, 0)], values=rg.Cell.OBSTACLE)
    rg.plan(_room(128, 128)).path(cell=(0, 0))


def _robots() -> None:
    for scene in (_ARM, _TURNING):
        rg.plan(scene).path(scene.starts[0])


def _joints() -> None:
    with suppress(rg.ToolMissingError):  # robots from URDF files cannot be used without their packages
        scene = rg.read_scene(shipped_scenes()["scara"])
        assert isinstance(scene.robot, rg.URDFRobot)
        # `rg.build_space` would read the verdicts of an earlier run from the cache and compile no kernel.
        prove_cells(scene.robot.among(scene.obstacles), scene.robot.axes(4), halvings=1)


def _control() -> None:
    for scene in (_ROOM, _ARM):
        rg.simulation(scene, k=0.9, learn=True, settle="sor").run()


def _chips() -> None:
    study = rg.study(_ROOM)
    study.settling()
    study.noise()
    study.sensitivity()
    study.faults()
    study.yields(trials=8)


def _many() -> None:
    netlist = rg.compile_space(_room(48, 48))
    spread = np.random.default_rng(0).normal(1.0, 0.01, (8, len(netlist.conductance)))
    rg.circuit.solve_many(netlist, netlist.conductance * spread)


CASES: dict[str, Callable[[], None]] = {
    case.__name__.strip("_").replace("_", " "): case
    for case in (
        _plane, _corridors, _paths, _irregular, _volume, _chips, _joints, _updates, _control, _robots, _many, _uneven,
        _plane_of_voltages, _open_obstacles,
    )
}  # fmt: skip
"""Warm-up jobs by name, in the order of decreasing compile time.

A job is a function without arguments that calls some kernels that the other jobs do not call.
"""


def compile_last_stages() -> None:
    """Compile the kernels of the last stages of ``resgrid run``: streamlines and clearances.

    This function solves no circuit, so that the process that calls it compiles none of the kernels that ``resgrid run``
    compiles first, at the same time, in its own process.
    """
    nothing, along = -np.inf, np.zeros((4, 1), np.int8)
    along[2] = 1
    field = rg.Field(
        space=rg.ConfigurationSpace(_axes(x=3, y=1), np.array([[1], [0], [2]], dtype=np.uint8)),
        wiring=rg.Wiring(),
        potential=np.array([[1.0], [0.5], [0.0]]),
        log_drop=None,
        face_direction=(along, np.zeros((3, 2), np.int8)),
        face_log_current=(np.where(along, 0.0, nothing), np.full((3, 2), nothing)),
        k=1.0,
    )
    _ = rg.streamline(field, (4.0, 4.0)).clearance


def compile_kernels(jobs: int | None = None) -> Iterator[str]:
    """Run all jobs of `CASES` in several processes, and yield the name of each finished job.

    `jobs`: largest number of processes, by default one per core.

    Raises
    ------
    Exception
        The exception of a job, which shows that the installation is broken.
    """
    workers = min(jobs or os.cpu_count() or 1, len(CASES))
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_disable_collector)
    try:
        running = {pool.submit(_run, name): name for name in CASES}
        for done in as_completed(running):
            done.result()
            yield running[done]
    finally:
        pool.shutdown(cancel_futures=True)


def _disable_collector() -> None:
    """Disable garbage collection in a worker process, where it takes 5 % of the time of compilation."""
    gc.disable()


def _run(name: str) -> None:
    """Run the job of `CASES` with the name `name` in a worker process."""
    CASES[name]()
