"""Writing a deck: the portable file, its commands for the simulator, its sidecar, and what makes ngspice check it."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal

from resgrid._internal.files import atomic_path
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.scene.chip import Chip
from resgrid.spice.analyses import Analysis, MismatchAnalysis, TransientAnalysis, kind_of
from resgrid.spice.dialects import dialect_named
from resgrid.spice.write.flat import flatten
from resgrid.spice.write.self_check import LARGEST, format_companion
from resgrid.spice.write.sidecar import digest, expect, format_sidecar, sidecar_path
from resgrid.spice.write.statements import additions, format_commands, only_one
from resgrid.spice.write.tile_deck import write_tiles
from resgrid.spice.write.tiles import difference_from_ideal, tile_values

Form = Literal["flat", "cells"]


@dataclasses.dataclass(frozen=True)
class WrittenDeck:
    """The files of one deck.

    `path`: the portable deck, without commands; `commands`: the file that includes it and asks the simulator for its
    operating point, or for other analyses; `sidecar`: hashes, cells, expected voltages and versions, as JSON;
    `sha256`: hash of the deck; `companion`: the file that makes ngspice print PASS or FAIL; None for other dialects,
    and where values are random; `chip, pattern`: in tile form, the array of tiles and the scene, which the deck
    includes; `left_out`: how many floating nodes, and elements by kind, of the circuit the deck does not hold.
    """

    path: Path
    commands: Path
    sidecar: Path
    sha256: str
    companion: Path | None = None
    chip: Path | None = None
    pattern: Path | None = None
    left_out: Mapping[str, int] = dataclasses.field(default_factory=dict)


def write_spice(
    circuit: Netlist | OperatingPoint,
    file: str | os.PathLike[str],
    dialect: str = "ngspice",
    *,
    title: str | None = None,
    chip: Chip | None = None,
    form: Form = "flat",
    analyses: Sequence[Analysis] = (),
    expected: Mapping[str, Any] | None = None,
    scene_sha256: str | None = None,
    verify: bool = True,
) -> WrittenDeck:
    """Write a deck, the simulator's commands, the sidecar, and for ngspice the companion that checks the deck.

    Parameters
    ----------
    circuit : Netlist or OperatingPoint
        A solved circuit, or a netlist, which is then solved: the sidecar holds the expected voltages.
    file : path-like
        The deck; ``FILE.json``, ``FILE.ngspice`` (the dialect's name) and ``FILE.verify`` are written beside it, in
        tile form also ``FILE.chip`` and ``FILE.pattern``.
    dialect : {"ngspice", "ltspice", "xyce", "hspice", "spectre"}
    title : str, optional
        First line of the deck.
    chip : Chip, optional
        For ``form="cells"``: what the netlist was built of (`build_chip`), with all switches of its tiles.
    form : {"flat", "cells"}
        One line per element, or an array of tiles and a pattern that sets their switches.
    analyses : sequence of Analysis
        What the commands ask for, instead of the operating point; such as `TransientAnalysis`.
    expected : mapping of str to object, optional
        Answers that the caller expects of the analyses, for the sidecar; must be JSON without NaN.
    scene_sha256 : str, optional
        Hash of the scene's file, for the sidecar.
    verify : bool
        Whether to write the companion.

    Returns
    -------
    WrittenDeck

    Raises
    ------
    InputError
        If the dialect or form is unknown, a file cannot be written, tiles cannot hold the netlist, or an analysis does
        not fit the deck.
    CircuitError
        If the netlist has no operating point.

    Examples
    --------
    >>> op = rg.solve(rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))))
    >>> written = rg.write_spice(op, "lesson.cir")
    >>> written.path.read_text().splitlines()[1]
    '* ngspice dialect: 58 nodes besides ground, 2 voltage sources, 140 resistors'
    >>> print(written.commands.read_text(), end="")
    * operating point of lesson.cir
    * ngspice -n -b -r operating_point.raw lesson.cir.ngspice
    .include "lesson.cir"
    .options klu
    .op
    .end
    """
    target = _checked_target(Path(file))
    circuit, asked = _drawn(circuit, analyses)
    op = circuit if isinstance(circuit, OperatingPoint) else solve(circuit)
    added = additions(asked, op.netlist, dialect_named(dialect))
    more: dict[str, Any] = {}
    if form == "cells":
        chip = Chip() if chip is None else chip
        deck = write_tiles(op.netlist, chip, target.name, dialect=dialect, title=title, additions=added)
        parts = {f"{target.name}.{suffix}": digest(text.encode()) for suffix, text in deck.parts.items()}
        more = {"form": form, "tile": tile_values(op.netlist, chip), "files": parts}
    else:
        deck = flatten(op.netlist, dialect=dialect, title=title, additions=added)
    answers = expect(deck, op)
    beside = {**deck.parts, deck.dialect.name: format_commands(target.name, deck, asked)}
    checks = len(answers.voltage) + len(answers.source_current) + len(deck.resistors)
    if verify and deck.dialect.checks_itself and not added.spread and checks <= LARGEST:
        beside["verify"] = format_companion(target.name, deck, answers, digest(deck.text.encode()))
    companions = {
        f"{target.name}.{key}": digest(text.encode()) for key, text in beside.items() if key not in deck.parts
    }
    more = {"companions": companions, **more}
    if analyses:
        more["analyses"] = [_described(item) for item in analyses]
    if expected is not None:
        try:
            json.dumps(expected, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError(f"expected answers must be JSON without NaN: {error}") from error
        more["expected"] = expected
    if scene_sha256 is not None:
        more["scene_sha256"] = scene_sha256
    if form == "cells":
        more["difference_from_flat"] = difference_from_ideal(op)
    beside["json"] = format_sidecar(target.name, deck, answers, more)
    files = {key: target.with_name(f"{target.name}.{key}") for key in beside}
    with ExitStack() as stack:  # all aside, then renamed, the deck last: an interrupted set contradicts its hashes
        for path, text in ((target, deck.text), *((files[key], text) for key, text in reversed(beside.items()))):
            stack.enter_context(atomic_path(path)).write_bytes(text.encode())
    return WrittenDeck(
        path=target,
        commands=files[deck.dialect.name],
        sidecar=files["json"],
        sha256=digest(deck.text.encode()),
        companion=files.get("verify"),
        chip=files.get("chip"),
        pattern=files.get("pattern"),
        left_out=deck.missing,
    )


def _drawn(
    circuit: Netlist | OperatingPoint, analyses: Sequence[Analysis]
) -> tuple[Netlist | OperatingPoint, list[Analysis]]:
    """The circuit of one chip of a mismatch that is drawn here, and what is left to ask of the simulator."""
    mismatch: MismatchAnalysis | None = only_one(analyses, MismatchAnalysis)
    if mismatch is None or mismatch.runs:
        return circuit, list(analyses)
    netlist = circuit.netlist if isinstance(circuit, OperatingPoint) else circuit
    asked = [item for item in analyses if item is not mismatch]
    for place, item in enumerate(asked):
        if isinstance(item, TransientAnalysis) and item.after is not None:
            asked[place] = dataclasses.replace(item, after=mismatch.apply(item.after))
    return mismatch.apply(netlist), asked


def _checked_target(target: Path) -> Path:
    sidecar_path(target)
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise InputError(f"cannot write a deck to {target}: its sidecar needs a place beside it; name a file")
    if '"' in target.name or not target.name.isprintable():
        raise InputError(f"cannot write a deck to {str(target)!r}: simulators cannot include a file of that name")
    return target


def _described(analysis: Analysis) -> dict[str, Any]:
    if isinstance(analysis, TransientAnalysis):
        changed = analysis.after is not None
        return {"kind": "transient", "stop": analysis.stop, "step": analysis.step, "changes_scene": changed}
    return {"kind": kind_of(analysis), **dataclasses.asdict(analysis)}
