"""Running ngspice on a file as it stands, in its own mode or as if it were another simulator."""

from __future__ import annotations

import subprocess
from pathlib import Path

from resgrid.spice.rawfile import RawFile, read_rawfile

MODES = {"ngspice": "none", "ltspice": "lt", "hspice": "hs"}


def run(path: Path, dialect: str = "ngspice") -> subprocess.CompletedProcess[str]:
    """Run a file in batch mode; the raw file is ``out.raw`` beside it."""
    (path.parent / "out.raw").unlink(missing_ok=True)
    command = ["ngspice", "-n", "-b", "-D", f"ngbehavior={MODES[dialect]}", "-r", "out.raw", path.name]
    return subprocess.run(command, cwd=path.parent, capture_output=True, text=True, check=False, timeout=60)


def waves(path: Path) -> dict[str, list[float]]:
    """The vectors of the first plot in a raw file by bare name (``n_0_0``, ``v_obstacle``)."""
    data = path.read_bytes()
    second = data.find(b"Title:", 1)
    raw: RawFile = read_rawfile(data if second < 0 else data[:second], "test")
    bare = [name[2:-1] if name[1:2] == "(" else name for name in raw.names]
    return dict(zip(bare, raw.values.T.tolist(), strict=True))


def verdict(path: Path) -> tuple[int, str]:
    """Exit status and verdict of a companion."""
    result = run(path)
    lines = [line for line in result.stdout.splitlines() if line.startswith(("PASS", "FAIL"))]
    return result.returncode, lines[0][:4] if lines else result.stdout + result.stderr
