"""Flushing of subnormal numbers in single precision: limited to the code that requests it.

Tests internals: `resgrid.solvers.llvm_intrinsics`.
"""

import platform

import numpy as np
from numba import njit
from support.spaces import space_of

import resgrid as rg
from resgrid.solvers.llvm_intrinsics import flush_subnormals, restore_subnormals

SMALLEST_NORMAL = np.finfo(np.float32).tiny
IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


@njit
def halved(x):
    return x * np.float32(0.5)


@njit
def halved_with_flushing(values):
    """Return halves computed while subnormal numbers are flushed to zero, and one half computed afterwards."""
    flags = flush_subnormals()
    within = np.empty_like(values)
    for k in range(len(values)):
        within[k] = halved(values[k])
    restore_subnormals(flags)
    return within, halved(values[0])


def test_subnormals_are_flushed_only_between_flush_and_restore() -> None:
    tiny = np.array([SMALLEST_NORMAL, 2.0 * SMALLEST_NORMAL], dtype=np.float32)
    within, after = halved_with_flushing(tiny)
    assert (within[0] == 0.0) == IS_X86
    assert within[1] == SMALLEST_NORMAL
    assert after > 0.0
    assert halved(SMALLEST_NORMAL) > 0.0


def test_progress_callbacks_keep_subnormals() -> None:
    cell = np.zeros((60, 60))
    cell[0, 0] = rg.Cell.GOAL
    seen = []
    netlist = rg.compile_space(space_of(cell))
    rg.solve(netlist, method="multigrid", progress=lambda *_: seen.append(float(halved(SMALLEST_NORMAL))))
    assert seen
    assert min(seen) > 0.0
