"""Running ngspice on a file as it stands, in its own mode or as if it were another simulator."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from resgrid.spice.run.rawfile import RawFile, read_rawfile

MODES = {"ngspice": "none", "ltspice": "lt", "hspice": "hs"}


def run(path: Path, dialect: str = "ngspice") -> subprocess.CompletedProcess[str]:
    """Run a file in batch mode; the raw file is ``out.raw`` beside it."""
    (path.parent / "out.raw").unlink(missing_ok=True)
    program = os.environ.get("RESGRID_NGSPICE", "ngspice")
    command = [program, "-n", "-b", "-D", f"ngbehavior={MODES[dialect]}", "-r", "out.raw", path.name]
    return subprocess.run(command, cwd=path.parent, capture_output=True, text=True, check=False, timeout=300)


def waves(path: Path, plot: str = "") -> dict[str, list[float]]:
    """The vectors of a plot in a raw file, the first by default, by bare name (``n_0_0``, ``v_obstacle``)."""
    plots = path.read_bytes().split(b"Title:")[1:]
    data = next(data for data in plots if f"Plotname: {plot}".encode() in data)
    raw: RawFile = read_rawfile(b"Title:" + data, "test")
    bare = [name[2:-1] if name[1:2] == "(" else name for name in raw.names]
    return dict(zip(bare, raw.values.T.tolist(), strict=True))


def verdict(path: Path) -> tuple[int, str]:
    """Exit status and verdict of a companion."""
    result = run(path)
    lines = [line for line in result.stdout.splitlines() if line.startswith(("PASS", "FAIL"))]
    return result.returncode, lines[0][:4] if lines else result.stdout + result.stderr
