"""The script of ``make fuzz``, run with a substitute for Python: seeds, options and exit status."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]

PYTHON = """#!/bin/sh
case "$1" in -c) echo 4711; exit;; esac
echo "$RESGRID_MUTATED_DECKS $RESGRID_PAGE_ACTIONS $RESGRID_PAGE_SEED $RESGRID_CIRCUITS $RESGRID_SEED $*" >> {log}
case "$*" in *{failing}*) exit 1;; esac
"""


def fuzz(folder: Path, failing: str = "nothing", **given: str) -> tuple[int, str, list[str]]:
    """Return exit code, output, and the recorded calls of a substitute for Python."""
    python, log = folder / "python", folder / "log"
    python.write_text(PYTHON.format(log=log, failing=failing))
    python.chmod(0o755)
    environment = {"PATH": os.environ["PATH"], **given}
    done = subprocess.run(
        [PROJECT / "scripts" / "fuzz.sh", python], env=environment, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout, log.read_text().splitlines()


@pytest.mark.parametrize(("given", "seed"), [({}, 4711), ({"SEED": "12"}, 12), ({"SEED": ""}, 4711)])
def test_every_part_uses_the_printed_seed(given: dict[str, str], seed: int, tmp_path: Path) -> None:
    code, said, calls = fuzz(tmp_path, **given, ROUNDS="2", COUNT="50")
    assert code == 0 and said.startswith(f"seed {seed} ")
    assert [f"--hypothesis-seed={seed + number}" in call for number, call in enumerate(calls[:2])] == [True, True]
    assert all("--hypothesis-profile=fuzz" in call for call in calls[:3])
    assert all("--timeout=0" in call for call in calls[2:])  # more than the ten minutes of a test that hangs
    assert calls[2].startswith("50 ") and "test_mutated_decks.py" in calls[2]
    assert f" 10000 {seed} " in calls[3] and "test_fuzzing.py" in calls[3]
    assert f" 20000 {seed} " in calls[4] and "test_cancellation.py" in calls[4]


@pytest.mark.parametrize("failing", ["-m hypothesis", "test_mutated_decks", "test_fuzzing", "test_cancellation"])
def test_a_failed_part_does_not_stop_other_parts(failing: str, tmp_path: Path) -> None:
    code, _, calls = fuzz(tmp_path, failing, ROUNDS="2")
    assert code == 1 and len(calls) == 5
