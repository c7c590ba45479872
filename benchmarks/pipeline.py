"""Section: the pipeline in one process, in units of a sparse matrix-vector product of the same circuit."""

from __future__ import annotations

from functools import partial

import numpy as np

import resgrid as rg
from benchmarks.layouts import boxes
from benchmarks.problems import equations
from benchmarks.rows import Row, Scale
from benchmarks.timing import Job, alternating, repeated, scaled, spread, timed
from resgrid.circuit.solve import solve
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.planning.trace import streamlines

PRODUCTS = "products"
BOUNDARIES = ("dirichlet", "neumann")
EVERY = 16
"""Stride over goal-connected cells: streamlines start from every n-th cell."""


def pipeline(scale: Scale) -> list[Row]:
    """Section: compile, solve, trace."""
    large, small, deep = {"tiny": (32, 24, 8), "quick": (2048, 512, 64), "full": (2048, 512, 64)}[scale.name]
    rows = [_compile_row(boxes(large, 2, large + scale.seed), b, scale) for b in BOUNDARIES]
    space = boxes(small, 2, small + scale.seed)
    rows += [_solve_row(space, b, "direction", scale) for b in BOUNDARIES]
    cube = boxes(deep, 3, deep + scale.seed)
    rows += [_solve_row(cube, b, a, scale) for b in BOUNDARIES for a in ("normwise", "direction")]
    return [*rows, _trace_row(space, scale)]


def compile_afresh(space: ConfigurationSpace, boundary: str) -> Netlist:
    """Compile a space without its cached values."""
    return compile_space(ConfigurationSpace(space.axes, space.cell), boundary=boundary)


def _ten_products(netlist: Netlist) -> Job:
    system = equations(netlist)
    x = np.random.default_rng(0).random(len(system.rhs))
    return repeated(lambda: system.matrix @ x)


def _in_products(name: str, job: Job, netlist: Netlist, scale: Scale, note: str = "") -> Row:
    seconds, _, ratio = alternating(job, _ten_products(netlist), scale.rounds)
    return Row(name, seconds.median, scaled(ratio, 10.0), PRODUCTS, note=note)


def _compile_row(space: ConfigurationSpace, boundary: str, scale: Scale) -> Row:
    fresh = partial(compile_afresh, space, boundary)
    return _in_products(f"compile {_shape(space)} {boundary}", fresh, fresh(), scale)


def _solve_row(space: ConfigurationSpace, boundary: str, accuracy: str, scale: Scale) -> Row:
    netlist = compile_space(space, boundary=boundary)
    job = partial(solve, netlist, accuracy=accuracy, rtol=1e-8)
    method = job().method
    return _in_products(f"solve {_shape(space)} {boundary}, {accuracy}", job, netlist, scale, method)


def _trace_row(space: ConfigurationSpace, scale: Scale) -> Row:
    field = rg.field(solve(compile_space(space)))
    starts = space.centre(np.argwhere(space.goal_connected)[::EVERY])
    steps = int(streamlines(field, starts).steps.sum())
    job = partial(streamlines, field, starts)
    seconds = spread([timed(job) for _ in range(scale.rounds)])
    name = f"trace {len(starts):,} starts of {_shape(space)}"
    return Row(name, seconds.median, scaled(seconds, 1e9 / steps), "ns a step")


def _shape(space: ConfigurationSpace) -> str:
    return f"{space.shape[0]}^{space.ndim}"
