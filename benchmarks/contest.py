"""Contenders that solve the same problems in turn, each in a separate process with one thread."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers import PEERS
from benchmarks.problems import Equations, Problem, equations
from resgrid.errors import ToolMissingError
from resgrid.solvers.petsc import find_petsc

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "APXCHOL_NUM_THREADS"), "1"
)
MET = 1.5
"""A residual up to this factor times the tolerance counts as reached."""


@dataclass(frozen=True)
class Run:
    """One run of one contender: seconds of every stage, or the reason for a failure."""

    seconds: Mapping[str, float] = field(default_factory=dict)
    iterations: int | None = None
    residual: float = np.inf
    method: str = ""
    failure: str = ""

    @property
    def total(self) -> float:
        """Return the seconds of all stages."""
        return sum(self.seconds.values())

    @property
    def work(self) -> float:
        """Return the seconds of the solve phase."""
        return self.seconds.get("solve", self.seconds.get("substitute", np.nan))


class Contender:
    """A worker process that solves problems on request."""

    def __init__(self, name: str) -> None:
        self.name = name
        python, environment = interpreter(name)
        self.process = subprocess.Popen(
            [python, "-m", "benchmarks.worker", name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
            env={**os.environ, **environment, **ONE_THREAD},
        )

    def ask(self, order: Mapping[str, Any], limit: float) -> dict[str, Any]:
        """Send an order and return the reply; end the process after ``limit`` seconds."""
        if self.process.poll() is not None:
            return {"failure": "its process had ended"}
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()
        ready, _, _ = select.select([self.process.stdout], [], [], limit)
        if not ready:
            self.close()
            return {"failure": f"not done after {limit:g} s"}
        line = self.process.stdout.readline()
        if not line:
            return {"failure": f"its process ended with status {self.process.wait()}"}
        return dict(json.loads(line))

    def close(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.communicate()


@cache
def interpreter(name: str) -> tuple[str, dict[str, str]]:
    """Return the Python that has a contender's library, and its environment variables."""
    if name in PEERS and PEERS[name].package == "petsc4py":
        with suppress(ToolMissingError):
            found = find_petsc()
            return found.python, found.environment
    return sys.executable, {}


@dataclass(frozen=True, eq=False)
class Arena:
    """The folder with the files of a problem, and the active contenders."""

    problem: Problem
    system: Equations
    folder: Path
    contenders: Mapping[str, Contender]


@contextmanager
def arena(problem: Problem, names: Sequence[str]) -> Iterator[Arena]:
    """Write the files of a problem, and start the contenders."""
    system = equations(problem.netlist())
    contenders = {name: Contender(name) for name in names}
    with tempfile.TemporaryDirectory(prefix="resgrid-bench-") as name:
        folder = Path(name)
        (folder / "problem.json").write_text(json.dumps(asdict(problem)))
        parts = {"indptr": system.matrix.indptr, "indices": system.matrix.indices, "data": system.matrix.data}
        for part, array in {**parts, "rhs": system.rhs, "nodes": system.nodes}.items():
            np.save(folder / f"{part}.npy", array)
        try:
            yield Arena(problem, system, folder, contenders)
        finally:
            for contender in contenders.values():
                contender.close()


def run_once(ring: Arena, name: str, *, rtol: float, limit: float, accuracy: str = "normwise") -> Run:
    """Run one contender once, and compute the residual of its solution in this process."""
    order = {"folder": str(ring.folder), "rtol": rtol, "accuracy": accuracy}
    reply = ring.contenders[name].ask(order, limit)
    if "failure" in reply:
        return Run(failure=reply["failure"])
    residual = ring.system.residual(np.load(ring.folder / f"{name}.npy"))
    return Run(reply["seconds"], reply.get("iterations"), residual, reply.get("method", ""))


def prepare(ring: Arena, name: str, limit: float) -> str:
    """Have a contender convert the problem to its format, untimed; return an error message or None."""
    order = {"folder": str(ring.folder), "prepare": True}
    return str(ring.contenders[name].ask(order, limit).get("failure", ""))
