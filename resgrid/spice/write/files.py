"""Writing a deck: the portable file, its commands for the simulator, its sidecar, and what makes ngspice check it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal

from resgrid.errors import InputError
from resgrid.files import atomic_path
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.solve import solve
from resgrid.scene.chip import Chip
from resgrid.spice.analyses import Analysis, MismatchAnalysis, TransientAnalysis, kind_of
from resgrid.spice.dialects import dialect_named
from resgrid.spice.write import companion
from resgrid.spice.write.expected import expect
from resgrid.spice.write.flat import Deck, flatten
from resgrid.spice.write.sidecar import format_sidecar, sidecar_path
from resgrid.spice.write.statements import additions, format_analyses, only_one
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
    includes.
    """

    path: Path
    commands: Path
    sidecar: Path
    sha256: str
    companion: Path | None = None
    chip: Path | None = None
    pattern: Path | None = None


def write_spice(
    circuit: Netlist | OperatingPoint,
    path: str | os.PathLike[str],
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
    path : path-like
        The deck; ``PATH.json``, ``PATH.ngspice`` (the dialect's name) and ``PATH.verify`` are written beside it, in
        tile form also ``PATH.chip`` and ``PATH.pattern``.
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
    """
    target = _checked_target(Path(path))
    mismatch: MismatchAnalysis | None = only_one(analyses, MismatchAnalysis)
    if mismatch is not None and not mismatch.runs:
        circuit = mismatch.apply(circuit.netlist if isinstance(circuit, OperatingPoint) else circuit)
    op = circuit if isinstance(circuit, OperatingPoint) else solve(circuit)
    after = _after(analyses, mismatch)
    added = additions(analyses, op.netlist, dialect_named(dialect), after)
    chip = Chip() if chip is None else chip
    if form == "cells":
        deck = write_tiles(op.netlist, chip, target.name, dialect=dialect, title=title, additions=added)
    else:
        deck = flatten(op.netlist, dialect=dialect, title=title, additions=added)
    foretold = expect(deck, op)
    rules = deck.dialect
    texts = {f"{target.name}.{suffix}": text for suffix, text in deck.parts.items()}
    parts = {name: _hash(text) for name, text in texts.items()}
    texts[f"{target.name}.{rules.name}"] = _commands(target.name, deck, analyses, after)
    checks = len(foretold.voltage) + len(foretold.source_current) + len(deck.resistors)
    if verify and rules.checks_itself and not added.spread and checks <= companion.LARGEST:
        text = companion.format_companion(target.name, deck, foretold, _hash(deck.text))
        texts[f"{target.name}.verify"] = text
    more: dict[str, Any] = {"companions": {name: _hash(text) for name, text in texts.items() if name not in parts}}
    if form == "cells":
        more |= {"form": form, "tile": tile_values(op.netlist, chip), "files": parts}
    if analyses:
        more["analyses"] = [_described(item) for item in analyses]
    if expected is not None:
        more["expected"] = _checked_json(expected)
    if scene_sha256 is not None:
        more["scene_sha256"] = scene_sha256
    if form == "cells":
        more["difference_from_flat"] = difference_from_ideal(op)
    sidecar = sidecar_path(target)
    texts[sidecar.name] = format_sidecar(target.name, deck, foretold, more)
    texts[target.name] = deck.text
    _write_all(target, texts)
    return WrittenDeck(
        path=target,
        commands=target.with_name(f"{target.name}.{rules.name}"),
        sidecar=sidecar,
        sha256=_hash(deck.text),
        companion=_beside(target, "verify", texts),
        chip=_beside(target, "chip", texts),
        pattern=_beside(target, "pattern", texts),
    )


def _after(analyses: Sequence[Analysis], mismatch: MismatchAnalysis | None) -> Netlist | None:
    """The circuit after a change of the scene."""
    transient: TransientAnalysis | None = only_one(analyses, TransientAnalysis)
    after = None if transient is None else transient.after
    return mismatch.apply(after) if after is not None and mismatch is not None and not mismatch.runs else after


def _checked_target(target: Path) -> Path:
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise InputError(f"cannot write a deck to {target}: its sidecar needs a place beside it; name a file")
    if '"' in target.name or not target.name.isprintable():
        raise InputError(f"cannot write a deck to {str(target)!r}: simulators cannot include a file of that name")
    return target


def _commands(name: str, deck: Deck, analyses: Sequence[Analysis], after: Netlist | None) -> str:
    if analyses and not all(isinstance(item, MismatchAnalysis) and not item.runs for item in analyses):
        return format_analyses(name, deck, analyses, after)
    source, volts = "", ""
    if deck.source_names:
        source, volts = deck.source_names[0], repr(float(deck.netlist.source_volts[deck.sources[0]]))
    return deck.dialect.commands.format(deck=name, source=source, volts=volts)


def _described(analysis: Analysis) -> dict[str, Any]:
    if isinstance(analysis, TransientAnalysis):
        changed = analysis.after is not None
        return {"kind": "transient", "stop": analysis.stop, "step": analysis.step, "changes_scene": changed}
    return {"kind": kind_of(analysis), **dataclasses.asdict(analysis)}


def _checked_json(expected: Mapping[str, Any]) -> Mapping[str, Any]:
    try:
        json.dumps(expected, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"expected answers must be JSON without NaN: {error}") from error
    return expected


def _beside(target: Path, suffix: str, texts: Mapping[str, str]) -> Path | None:
    name = f"{target.name}.{suffix}"
    return target.with_name(name) if name in texts else None


def _write_all(target: Path, texts: Mapping[str, str]) -> None:
    """Write every file aside, then rename them, the deck last: a set that was interrupted contradicts its hashes."""
    with ExitStack() as stack:
        for name, text in reversed(list(texts.items())):
            stack.enter_context(atomic_path(target.with_name(name))).write_bytes(text.encode("utf-8"))


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
