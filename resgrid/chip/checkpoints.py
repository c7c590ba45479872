"""What a long count keeps on disk, so that it can be killed at any moment and taken up again."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from resgrid.chip.trials import Experiment, Tally
from resgrid.errors import InputError
from resgrid.files import atomic_path
from resgrid.netlist import Netlist

_SCHEMA = 1


def fingerprint(experiment: Experiment, batch: int) -> str:
    """A hash of everything that the counts of an experiment depend on, hexadecimal."""
    digest = hashlib.sha256(f"{_SCHEMA} {experiment.seed} {batch} {experiment.chip}".encode())
    digest.update(experiment.starts.tobytes())
    digest.update(experiment.floor.around.tobytes())
    for item in dataclasses.fields(Netlist):
        value = getattr(experiment.netlist, item.name)
        if isinstance(value, np.ndarray):
            digest.update(item.name.encode() + value.tobytes())
    for eyes in experiment.eyes:
        digest.update(repr(None if eyes is None else (eyes.low, eyes.span, eyes.steps, eyes.offset)).encode())
    return digest.hexdigest()


def save_tally(path: str | os.PathLike[str], tally: Tally, mark: str) -> None:
    """Write the counts so far, whole or not at all."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            fingerprint=np.array(mark),
            trials=np.array(tally.trials),
            reached=tally.reached,
            complete=tally.complete,
            squares=tally.squares,
        )


def load_tally(path: str | os.PathLike[str], mark: str) -> Tally | None:
    """Read the counts so far; None if there is no such file."""
    try:
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as data:
            found, trials = str(data["fingerprint"]), int(data["trials"])
            counts = [data[name] for name in ("reached", "complete", "squares")]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InputError(f"cannot read the checkpoint {str(path)!r}: {error}; remove it or name another") from error
    if found != mark:
        raise InputError(
            f"the checkpoint {str(path)!r} belongs to another run: the scene, the chip, the seed or the batch differs; "
            "remove it or name another"
        )
    return Tally(trials, *counts)
