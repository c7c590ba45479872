"""What a job may take: memory is estimated and refused before it is taken."""

from __future__ import annotations

import os
import shutil
import sys
from math import prod
from pathlib import Path

from resgrid.errors import BudgetError

BYTES_PER_CELL = 16
"""Memory of a scene's cell while it is sampled."""

FEWER_CELLS = "take fewer, larger cells"
SMALLER_MAP = (
    "crop the map to the part that you need, or scale its picture down and enlarge the width of its cells alike (ROS: "
    "resolution; pictures and arrays: --spacing)"
)
FEWER_HEADINGS = "take fewer headings (--set map.headings=16)"
"""Remedies for a scene, a map, and a robot that turns on a map, whose cells do not fit."""

_GROUP = Path("/sys/fs/cgroup")
"""Where Linux tells what a container may take and has taken (cgroup v2)."""


def available_memory() -> int:
    """Memory that this process may still take, in bytes, from the kernel's own estimate and the container's limit."""
    free, left = _meminfo_available(), _container_left()
    return free if left is None else min(free, left)


def require_memory(needed: float, job: str, remedy: str) -> None:
    """Refuse a job that will not fit."""
    free = available_memory()
    if needed > free:
        raise BudgetError(f"{job} needs about {needed / 2**30:.3g} GiB, but {free / 2**30:.3g} GiB is free; {remedy}")


def require_disk(needed: float, folder: Path, job: str) -> None:
    """Refuse files that a folder has no room for."""
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise BudgetError(
            f"{job} need about {needed / 2**30:.3g} GiB in {folder.parent}, but {free / 2**30:.3g} GiB is free "
            "there; set TMPDIR to a folder on a larger disk"
        )


def require_grid_memory(
    shape: tuple[int, ...], what: str, bytes_per_cell: int = BYTES_PER_CELL, remedy: str = FEWER_CELLS
) -> None:
    """Raise BudgetError for a grid that would not fit in memory, before anything is allocated."""
    size = " x ".join(map(str, shape))
    require_memory(prod(shape) * bytes_per_cell, f"{what}: {size} = {prod(shape):.3g} cells", remedy)


def _meminfo_available() -> int:
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    if not hasattr(os, "sysconf"):  # Windows, which tells nobody without a library: nothing is refused there
        return sys.maxsize
    return int(os.sysconf("SC_PAGE_SIZE")) * int(os.sysconf("SC_PHYS_PAGES"))


def _container_left() -> int | None:
    """What a container's limit leaves; pages of files that nobody uses are given up first, and count as free."""
    try:
        limit, taken = (int((_GROUP / name).read_text()) for name in ("memory.max", "memory.current"))
        rows = dict(line.split() for line in (_GROUP / "memory.stat").read_text().splitlines())
    except (OSError, ValueError):  # no cgroup v2, or no limit ("max")
        return None
    return max(limit - taken + int(rows.get("inactive_file", 0)), 0)
