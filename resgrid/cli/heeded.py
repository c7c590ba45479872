"""What a verb does not heed of a scene is said, or refused, by name."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from resgrid.cli.job import only_boundary
from resgrid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from resgrid.chip.build import Form
    from resgrid.cli.job import Job
    from resgrid.cli.report import Report
    from resgrid.scene import Chip

_READ = "they say how voltages are read, and a circuit holds no meter; 'resgrid chip' heeds them"
_WHY = {
    "circuit": _READ,
    "tiles": _READ,
    "grid": "fields and paths are those of the ideal grid (decks hold the chip); 'resgrid chip' asks what they do to a "
    "robot",
}


def tell_unheeded(
    job: Job, form: Form | Literal["chip"], report: Report, *, k: Sequence[float] = ()
) -> dict[str, list[str]]:
    """Say which keys of a scene make no difference to what a verb makes of it."""
    from resgrid.chip.build import keys_not_held

    keys = [] if form == "chip" else [f"chip.{key}" for key in keys_not_held(job.scene.chip, form)]
    if keys:
        report.say(f"not heeded: {', '.join(keys)}: {_WHY[form]}")
    k = k if form == "grid" else several_k(job)
    if k:
        report.say(
            f"not heeded: k = {', '.join(f'{share:g}' for share in k)}: this is one chip or one blend; choose it with "
            "--boundary or --k ('resgrid run' makes them all)"
        )
    drive = job.scene.drive is not None and not _is_driven(job, form)
    if drive:
        report.say(f"not heeded: drive = {job.scene.drive!r}: here obstacles are a rail, and that drives the grid")
    return {"not_heeded": [*keys, *(["k"] if k else []), *(["drive"] if drive else [])]}


def _is_driven(job: Job, form: Form | Literal["chip"]) -> bool:
    """Whether anything is made whose obstacles are open."""
    if form != "grid":
        return only_boundary(job)[0] == "neumann"
    return any(share < 1 for share in job.scene.k) if job.scene.k else job.scene.boundary == "neumann"


def several_k(job: Job) -> tuple[float, ...]:
    """The blends of a scene that asks for several."""
    return job.scene.k if len(job.scene.k) > 1 else ()


def require_tiles(chip: Chip) -> None:
    """Refuse a chip that an array of tiles cannot be."""
    from resgrid.chip.build import READING, keys_not_held

    keys = [f"chip.{key}" for key in keys_not_held(chip, "tiles") if key not in READING]
    if keys:
        raise InputError(
            f"tiles cannot hold {', '.join(keys)}: write the flat form, which does, or remove them from [chip]"
        )


def assume_switches(job: Job, boundary: str, report: Report) -> tuple[Job, dict[str, float]]:
    """A scene whose chip has all the switches of its tiles, and, as said, those that it does not describe, in ohms."""
    from resgrid.spice.write.tiles import with_tile_switches

    chip = with_tile_switches(job.scene.chip, boundary)
    assumed = {f"chip.{key}": ohms for key, ohms in vars(chip).items() if ohms != getattr(job.scene.chip, key)}
    if assumed:
        values = ", ".join(f"{key} = {ohms:g}" for key, ohms in assumed.items())
        report.say(f"tiles have switches, and [chip] does not describe all; assumed, in ohms: {values}")
    return replace(job, scene=replace(job.scene, chip=chip)), assumed
