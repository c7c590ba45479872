"""Choice between worker processes on all cores and none, for long computations of the command line."""

from __future__ import annotations

import os
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext

import resgrid as rg

MANY_CELLS = 2**15
"""Smallest number of cells of a space for which worker processes save more time than their start takes."""


def workers_for(scene: rg.Scene, cells: int) -> AbstractContextManager[Executor | None]:
    """Return a context that yields an executor on all cores, or None if worker processes would not save time.

    They save time on several cores for a robot that moves in three dimensions, with the sampling "conservative", which
    proves cells free, and a configuration space of at least `MANY_CELLS` (32,768) cells. `cells`: number of cells of
    this space.
    """
    is_long = scene.robot.workspace_ndim == 3 and scene.sampling == "conservative" and cells >= MANY_CELLS
    return rg.open_executor("processes") if is_long and (os.cpu_count() or 1) > 1 else nullcontext()
