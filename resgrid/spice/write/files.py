"""`write_spice` and its result: a deck in one dialect, a file of analyses, a sidecar, and a self-check deck."""

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
from resgrid.spice.write.self_check import LARGEST, format_self_check
from resgrid.spice.write.sidecar import digest, expect, format_sidecar, sidecar_path
from resgrid.spice.write.statements import additions, format_commands, only_one
from resgrid.spice.write.tile_deck import write_tiles
from resgrid.spice.write.tiles import difference_from_ideal, tile_values

Form = Literal["flat", "cells"]


@dataclasses.dataclass(frozen=True)
class WrittenDeck:
    """Paths of the files of one deck.

    Returned by `resgrid.write_spice` and, by name, by `resgrid.chip.Study.write_decks`.

    Attributes
    ----------
    path : pathlib.Path
        The portable deck, without commands.
    commands : pathlib.Path
        The file that includes the deck and requests the operating point or other analyses.
    sidecar : pathlib.Path
        JSON with hashes, cells, expected voltages and currents, and versions.
    sha256 : str
        Hash of the deck, 64 hexadecimal digits.
    companion : pathlib.Path or None
        The self-check deck, with which ngspice prints PASS or FAIL; None if it was not written: for other dialects, for
        resistances that the simulator draws, without ``verify``, and for more than 400,000 comparisons.
    chip, pattern : pathlib.Path or None
        Files that a deck in tile form (one subcircuit per cell) includes: the array of subcircuits, and the states of
        the cells.  None in flat form.
    left_out : mapping of str to int
        Number of floating nodes (key ``"floating node"``) and of elements of each kind that the deck omits; a number of
        0 is absent.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> written = rg.write_spice(netlist, "lesson.cir")
    >>> [path.name for path in (written.path, written.commands, written.sidecar, written.companion)]
    ['lesson.cir', 'lesson.cir.ngspice', 'lesson.cir.json', 'lesson.cir.verify']
    >>> written.path.read_text().splitlines()[1]
    '* ngspice dialect: 58 nodes besides ground, 2 voltage sources, 140 resistors'
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
    """Write a deck, the simulator's commands, the sidecar, and for ngspice the self-check deck.

    Parameters
    ----------
    circuit : Netlist or OperatingPoint
        A solved circuit.  A netlist is solved first, because the sidecar holds the expected voltages.
    file : path-like
        The deck.  ``FILE.json``, ``FILE.ngspice`` (the dialect's name) and ``FILE.verify`` are written to the same
        folder, in tile form also ``FILE.chip`` and ``FILE.pattern``.
    dialect : {"ngspice", "ltspice", "xyce", "hspice", "spectre"}
        Simulator that will read the deck.
    title : str, optional
        First line of the deck, cut at 200 characters; by default a description of the circuit.
    chip : Chip, optional
        The chip that the netlist was built from (`build_chip`), with all switches of its tiles.  Required for
        ``form="cells"``; ignored in flat form.
    form : {"flat", "cells"}
        One line per element; or tile form: one subcircuit per cell, and a parameter per cell that sets its switches.
    analyses : sequence of Analysis
        Analyses that the commands request in place of the operating point, such as `TransientAnalysis`.
    expected : mapping of str to object, optional
        Expected results of the analyses, stored in the sidecar; must be JSON without NaN.
    scene_sha256 : str, optional
        Hash of the scene's file, stored in the sidecar.
    verify : bool
        Whether to write the self-check deck, with which ngspice compares its results with the expected ones.  Other
        dialects have none.

    Returns
    -------
    WrittenDeck
        Paths of the files, and the hash of the deck.

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
    target = checked_target(Path(file))
    circuit, requested = _apply_mismatch(circuit, analyses)
    op = circuit if isinstance(circuit, OperatingPoint) else solve(circuit)
    added = additions(requested, op.netlist, dialect_named(dialect))
    more: dict[str, Any] = {}
    if form == "cells":
        chip = Chip() if chip is None else chip
        deck = write_tiles(op.netlist, chip, target.name, dialect=dialect, title=title, additions=added)
        parts = {f"{target.name}.{suffix}": digest(text.encode()) for suffix, text in deck.parts.items()}
        more = {"form": form, "tile": tile_values(op.netlist, chip), "files": parts}
    else:
        deck = flatten(op.netlist, dialect=dialect, title=title, additions=added)
    answers = expect(deck, op)
    texts = {**deck.parts, deck.dialect.name: format_commands(target.name, deck, requested)}
    checks = len(answers.voltage) + len(answers.source_current) + len(deck.resistors)
    if verify and deck.dialect.checks_itself and not added.spread and checks <= LARGEST:
        texts["verify"] = format_self_check(target.name, deck, answers, digest(deck.text.encode()))
    companions = {f"{target.name}.{key}": digest(text.encode()) for key, text in texts.items() if key not in deck.parts}
    more = {"companions": companions, **more}
    if analyses:
        more["analyses"] = [_described(item) for item in analyses]
    if expected is not None:
        try:
            json.dumps(expected, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError(f"expected must hold only values that JSON can store, without NaN: {error}") from error
        more["expected"] = expected
    if scene_sha256 is not None:
        more["scene_sha256"] = scene_sha256
    if form == "cells":
        more["difference_from_flat"] = difference_from_ideal(op)
    texts["json"] = format_sidecar(target.name, deck, answers, more)
    files = write_set(target, deck.text, texts)
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


def _apply_mismatch(
    circuit: Netlist | OperatingPoint, analyses: Sequence[Analysis]
) -> tuple[Netlist | OperatingPoint, list[Analysis]]:
    """Return the circuit to write, with random resistances if resgrid draws them, and the analyses for the simulator.

    resgrid draws the resistances if `analyses` contains a `MismatchAnalysis` with ``runs = 0``; the returned circuit is
    then a netlist, and the returned analyses do not contain that analysis.  Otherwise both arguments are returned.
    """
    mismatch: MismatchAnalysis | None = only_one(analyses, MismatchAnalysis)
    if mismatch is None or mismatch.runs:
        return circuit, list(analyses)
    netlist = circuit.netlist if isinstance(circuit, OperatingPoint) else circuit
    requested = [item for item in analyses if item is not mismatch]
    for place, item in enumerate(requested):
        if isinstance(item, TransientAnalysis) and item.after is not None:
            requested[place] = dataclasses.replace(item, after=mismatch.apply(item.after))
    return mismatch.apply(netlist), requested


def checked_target(target: Path) -> Path:
    """Return `target`, the path of a deck; raise InputError if no sidecar or command file can accompany a deck there.

    Pipes and devices are rejected, and names that are empty, not printable or contain double quotes.
    """
    sidecar_path(target)
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise InputError(
            f"cannot write a deck to {target}: its sidecar needs a regular file next to it; give the name of a file"
        )
    if '"' in target.name or not target.name.isprintable():
        raise InputError(
            f"cannot write a deck to {str(target)!r}: simulators cannot include a file of that name; "
            "use printable characters without quotes"
        )
    return target


def write_set(target: Path, deck: str, texts: Mapping[str, str]) -> dict[str, Path]:
    """Write a deck and the files that accompany it; return the paths of the accompanying files by suffix.

    The name of a file is that of the deck, a point and the suffix, such as ``room.cir.json``.  Files get their names at
    the end, the deck last, so that hashes reveal an interrupted set.  `target`, `deck`: path and content of the deck;
    `texts`: contents of the accompanying files by suffix.
    """
    files = {key: target.with_name(f"{target.name}.{key}") for key in texts}
    with ExitStack() as stack:
        for path, text in ((target, deck), *((files[key], text) for key, text in reversed(list(texts.items())))):
            stack.enter_context(atomic_path(path)).write_bytes(text.encode())
    return files


def _described(analysis: Analysis) -> dict[str, Any]:
    """Return an analysis as a dict of JSON values for the sidecar: ``kind`` ("noise" and so on) and its attributes.

    A transient analysis has only ``stop`` and ``step`` in seconds, and ``changes_scene``: whether the circuit changes.
    """
    if isinstance(analysis, TransientAnalysis):
        changed = analysis.after is not None
        return {"kind": "transient", "stop": analysis.stop, "step": analysis.step, "changes_scene": changed}
    return {"kind": kind_of(analysis), **dataclasses.asdict(analysis)}
