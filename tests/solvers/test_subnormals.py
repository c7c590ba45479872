import platform
import threading

import numpy as np
import pytest
from numba import njit
from support.spaces import space_of

import resgrid as rg
from resgrid.solvers.multigrid.subnormals import subnormals_as_zero

SMALLEST_NORMAL = np.finfo(np.float32).tiny
IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


@njit
def halved(x):
    return x * np.float32(0.5)


def test_subnormals_are_zero_inside_alone_whatever_happens_there() -> None:
    assert halved(SMALLEST_NORMAL) > 0.0
    with pytest.raises(KeyError), subnormals_as_zero():
        assert (halved(SMALLEST_NORMAL) == 0.0) == IS_X86
        assert halved(np.float32(2.0) * SMALLEST_NORMAL) == SMALLEST_NORMAL
        raise KeyError
    assert halved(SMALLEST_NORMAL) > 0.0


def test_other_threads_keep_them() -> None:
    begun, seen = threading.Event(), []

    def work() -> None:
        begun.wait(10)
        seen.append(halved(SMALLEST_NORMAL))

    other = threading.Thread(target=work)
    other.start()
    with subnormals_as_zero():
        begun.set()
        other.join()
    assert seen[0] > 0.0


def test_who_watches_a_solution_keeps_them() -> None:
    cell = np.zeros((60, 60))
    cell[0, 0] = rg.Cell.GOAL
    seen = []
    netlist = rg.compile_space(space_of(cell))
    rg.solve(netlist, method="multigrid", progress=lambda *_: seen.append(float(halved(SMALLEST_NORMAL))))
    assert seen
    assert min(seen) > 0.0
