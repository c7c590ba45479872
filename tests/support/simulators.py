"""Run ngspice on an unmodified file, in its own mode or in a compatibility mode."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from resgrid.spice.run.rawfile import RawFile, read_rawfile

MODES = {"ngspice": "none", "ltspice": "lt", "hspice": "hs"}


def run(path: Path, dialect: str = "ngspice") -> subprocess.CompletedProcess[str]:
    """Run a file in batch mode; the raw file is ``out.raw`` in the same folder."""
    (path.parent / "out.raw").unlink(missing_ok=True)
    program = os.environ.get("RESGRID_NGSPICE", "ngspice")
    command = [program, "-n", "-b", "-D", f"ngbehavior={MODES[dialect]}", "-r", "out.raw", path.name]
    return subprocess.run(command, cwd=path.parent, capture_output=True, text=True, check=False, timeout=300)


def waves(path: Path, plot: str = "") -> dict[str, list[float]]:
    """Return the vectors of a plot in a raw file, the first by default, by bare name (``n_0_0``, ``v_obstacle``)."""
    plots = path.read_bytes().split(b"Title:")[1:]
    data = next(data for data in plots if f"Plotname: {plot}".encode() in data)
    raw: RawFile = read_rawfile(b"Title:" + data, "test")
    bare = [name[2:-1] if name[1:2] == "(" else name for name in raw.names]
    return dict(zip(bare, raw.values.T.tolist(), strict=True))


def verdict(path: Path) -> tuple[int, str]:
    """Return the exit status and the verdict of a self-check deck."""
    result = run(path)
    lines = [line for line in result.stdout.splitlines() if line.startswith(("PASS", "FAIL"))]
    return result.returncode, lines[0][:4] if lines else result.stdout + result.stderr
