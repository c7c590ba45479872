"""Checks, before a job starts, that the available memory and disk space suffice for the job."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from math import prod
from pathlib import Path

from resgrid.errors import BudgetError

BYTES_PER_CELL = 16
"""Estimated memory per cell in bytes while the cells of a scene are classified as free, obstacle or goal."""

FEWER_CELLS = "take fewer, larger cells"
SMALLER_MAP = (
    "crop the map to the part that you need, or scale its picture down and enlarge the width of its cells alike (ROS: "
    "resolution; pictures and arrays: --spacing)"
)
FEWER_HEADINGS = "take fewer headings (--set map.headings=16)"
"""Advice in messages if cells exceed the memory: `FEWER_CELLS` for the cells of a scene, `SMALLER_MAP` for those of a
map, `FEWER_HEADINGS` for those of a robot that turns on a map.
"""

Remedy = str | Callable[[float], str]
"""Advice in a message: text, or a function that returns the text for the ratio of needed to available memory."""

_GROUP = Path("/sys/fs/cgroup")
"""Folder in which Linux reports the memory limit and use of a container (cgroup v2)."""


def available_memory() -> int:
    """Return the memory in bytes that this process can still allocate.

    This is the smaller of the estimate of the operating system and the unused part of the limit of the container.
    """
    free, left = _meminfo_available(), _container_left()
    return free if left is None else min(free, left)


def require_memory(needed: float, job: str, remedy: Remedy) -> None:
    """Raise BudgetError if a job needs more than the available memory.

    `needed`: memory of the job in bytes; `job`, `remedy`: name of the job and advice, for the message.
    """
    free = available_memory()
    if needed > free:
        advice = remedy if isinstance(remedy, str) else remedy(needed / max(free, 1))
        raise BudgetError(f"{job} needs about {needed / 2**30:.3g} GiB, but {free / 2**30:.3g} GiB is free; {advice}")


def require_disk(needed: float, folder: Path, job: str) -> None:
    """Raise BudgetError if files need more than the free space of the disk that holds `folder`.

    `needed`: size of the files in bytes; `job`: name of the files, for the message.
    """
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise BudgetError(
            f"{job} need about {needed / 2**30:.3g} GiB in {folder.parent}, but {free / 2**30:.3g} GiB is free "
            "there; set TMPDIR to a folder on a larger disk"
        )


def require_grid_memory(
    shape: tuple[int, ...], what: str, bytes_per_cell: int = BYTES_PER_CELL, remedy: Remedy = FEWER_CELLS
) -> None:
    """Raise BudgetError if a grid would not fit in memory.

    `shape`: number of cells along every axis; `what`, `remedy`: name of the grid and advice, for the message;
    `bytes_per_cell`: memory per cell in bytes.
    """
    size = " x ".join(map(str, shape))
    require_memory(prod(shape) * bytes_per_cell, f"{what}: {size} = {prod(shape):.3g} cells", remedy)


def _meminfo_available() -> int:
    """Return the available memory in bytes, estimated by the operating system; the largest integer on Windows.

    If the system has no file ``/proc/meminfo`` with an estimate (macOS), the result is the whole physical memory.
    """
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    if not hasattr(os, "sysconf"):  # Windows reports its memory through libraries only
        return sys.maxsize
    return int(os.sysconf("SC_PAGE_SIZE")) * int(os.sysconf("SC_PHYS_PAGES"))


def _container_left() -> int | None:
    """Return the memory in bytes below the limit of the container; None if the container has no limit.

    Inactive file pages count as unused, because the system frees them when memory is needed.
    """
    try:
        limit, taken = (int((_GROUP / name).read_text()) for name in ("memory.max", "memory.current"))
        rows = dict(line.split() for line in (_GROUP / "memory.stat").read_text().splitlines())
    except (OSError, ValueError):  # no cgroup v2, or no limit ("max")
        return None
    return max(limit - taken + int(rows.get("inactive_file", 0)), 0)
