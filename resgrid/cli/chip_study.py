"""A chip under study: the scene, its circuit and operating point, and how long to go on."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resgrid.cli.chip_parameters import described
from resgrid.cli.options import SceneChoice
from resgrid.cli.report import Report
from resgrid.cli.scenes import Job, compile_options, only_boundary, open_job, size_of
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.chip.precision import Precision
    from resgrid.netlist import Netlist
    from resgrid.nodal.operating_point import OperatingPoint
    from resgrid.scene import Chip


ANALYSES = ("yield", "precision", "settling", "noise", "power", "sensitivity", "exploration", "defects")
"""Every analysis, in the order of the report."""


@dataclass(frozen=True)
class Limits:
    """How long to go on, and where an interrupted run is taken up.

    `half_width`: of the yield's interval; `most`: chips; `jobs`: processes; 0 for one per core; `seconds`: for making
    elements faulty; `sweep`: values to explore, none or two; `checkpoint`: folder of the results, beside which the
    counts are kept.
    """

    half_width: float
    most: int
    jobs: int
    seconds: float
    sweep: tuple[tuple[str, tuple[float | int, ...]], ...]
    checkpoint: Path

    def __post_init__(self) -> None:
        if not 0 < self.half_width < 0.5:
            raise InputError(f"--half-width {self.half_width}: it lies between 0 and 0.5, such as 0.01")
        if self.most < 1 or self.jobs < 0 or not self.seconds > 0:
            raise InputError("--most must be at least 1, --jobs at least 0 and --seconds positive")
        if len(self.sweep) not in (0, 2):
            raise InputError("--sweep explores two values: give it twice, or not at all")

    @contextmanager
    def workers(self) -> Iterator[Executor | None]:
        """Processes for trials, or None."""
        if self.jobs == 1:
            yield None
            return
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        count = self.jobs or os.cpu_count() or 1
        with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as executor:
            yield executor


@dataclass(frozen=True, eq=False)
class Study:
    """One chip of a scene, and what was found out about it so far."""

    job: Job
    boundary: str
    start: int | None
    limits: Limits
    ideal: Netlist
    netlist: Netlist
    point: OperatingPoint
    results: dict[str, Any] = field(default_factory=dict)

    @property
    def chip(self) -> Chip:
        """What the scene says of it."""
        return self.job.scene.chip

    @property
    def title(self) -> str:
        """The scene's, for headings."""
        return self.job.scene.title or Path(self.job.scene.source or "chip").stem

    @property
    def bits(self) -> int:
        """Of the converter; 10 where it is ideal, for comparison."""
        return self.chip.readout.bits or 10

    @property
    def span(self) -> float:
        """Range of the converter, in volts."""
        low, high = self.chip.readout.range or (0.0, abs(self.chip.supply))
        return high - low

    @property
    def flat(self) -> bool:
        """Whether there are maps to draw."""
        return self.job.space.ndim == 2

    @cached_property
    def linear(self) -> Netlist:
        """The chip, or its small-signal circuit where it is nonlinear."""
        from resgrid.nodal.secant import small_signal

        return small_signal(self.point) if self.netlist.nonlinear_nodes.size else self.netlist

    @cached_property
    def precision(self) -> Precision:
        """Bits that its cells need."""
        from resgrid.chip.precision import analyse_precision

        return analyse_precision(self.point, span=self.span)

    @property
    def options(self) -> dict[str, Any]:
        """How its space is compiled."""
        return compile_options(self.job, self.boundary, self.start)

    def parameters(self) -> list[tuple[str, str, str]]:
        """What the scene says of the chip: key, value, meaning."""
        return described(self.chip, f"{size_of(self.job.space.shape)} cells", self.boundary)

    def description(self) -> dict[str, Any]:
        """The same for JSON."""
        return dataclasses.asdict(self.chip)

    @property
    def checkpoint(self) -> Path:
        """Where the counts of this very study are kept."""
        import hashlib

        told = f"{self.chip} {self.options} {self.limits.half_width}"
        mark = hashlib.sha256(told.encode() + self.job.space.cell.tobytes()).hexdigest()[:12]
        folder = self.limits.checkpoint
        return folder.parent / f".{folder.name}-{mark}.yield.npz"

    def forget(self) -> None:
        """Remove the counts of a study that is done."""
        self.checkpoint.unlink(missing_ok=True)


def open_study(choice: SceneChoice, report: Report, limits: Limits) -> Study:
    """Read a scene, build its chip and find the operating point."""
    from resgrid.chip.build import build_chip, ideal_netlist
    from resgrid.nodal.solve import solve

    job = open_job(choice)
    if not job.space.goal_connected.any():
        raise InputError("no free cell has a way to a goal, so there is nothing for a chip to do; open one")
    boundary, start = only_boundary(job)
    with report.stage("build the chip"):
        ideal = ideal_netlist(job.space, job.scene.chip, **compile_options(job, boundary, start))
        netlist = build_chip(ideal, job.scene.chip)
    point = report.compute("solve the chip", solve, netlist, seconds=0.5 + 3e-8 * netlist.node_count**1.5)
    return Study(job, boundary, start, limits, ideal, netlist, point)
