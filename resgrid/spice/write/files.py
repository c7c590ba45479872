"""Writing a deck: the portable file, its commands for the simulator, its sidecar, and what makes ngspice check it."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from resgrid.errors import InputError
from resgrid.files import atomic_path
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.analyses import Analysis, MismatchAnalysis, TransientAnalysis, kind_of
from resgrid.spice.dialects import dialect_named
from resgrid.spice.text.texts import Texts
from resgrid.spice.write import companion
from resgrid.spice.write.cells import CellDeck, tile_deck
from resgrid.spice.write.expected import expect
from resgrid.spice.write.flat import FlatDeck, flatten
from resgrid.spice.write.sidecar import format_sidecar, sidecar_path
from resgrid.spice.write.statements import additions, format_analyses, only_one
from resgrid.spice.write.tiles import Tile, expanded_netlist

Form = Literal["flat", "cells"]
FORMS: tuple[Form, ...] = ("flat", "cells")
_USUAL = Tile()


@dataclass(frozen=True)
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


@dataclass(frozen=True, eq=False)
class _Content:
    """What a deck of either form consists of."""

    flat: FlatDeck
    text: str
    resistors: Texts
    values: Any
    parts: Mapping[str, str]


def write_spice(
    netlist: Netlist,
    path: str | os.PathLike[str],
    dialect: str = "ngspice",
    *,
    title: str | None = None,
    operating_point: OperatingPoint | None = None,
    form: Form = "flat",
    tile: Tile = _USUAL,
    analyses: Sequence[Analysis] = (),
    expected: Mapping[str, Any] | None = None,
    scene_sha256: str | None = None,
    verify: bool = True,
) -> WrittenDeck:
    """Write a deck, the simulator's commands, the sidecar, and for ngspice the companion that checks the deck.

    Parameters
    ----------
    netlist : Netlist
    path : path-like
        The deck; ``PATH.json``, ``PATH.ngspice`` (the dialect's name) and ``PATH.verify`` are written beside it, in
        tile form also ``PATH.chip`` and ``PATH.pattern``.
    dialect : str
        One of `resgrid.spice.dialects.DIALECTS`.
    title : str, optional
        First line of the deck.
    operating_point : OperatingPoint, optional
        Where the expected voltages come from, for the flat form; without it the netlist is solved.
    form : {"flat", "cells"}
        One line per element, or an array of tiles and a pattern that sets their switches (see
        `resgrid.spice.write.tiles`): its expected voltages are those of `expanded_netlist`.
    tile : Tile
        Values of the tiles, for ``form="cells"``.
    analyses : sequence of Analysis
        What the commands ask for, instead of the operating point; see `resgrid.spice.analyses`.
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
        If the dialect or form is unknown, a file cannot be written, the operating point belongs to another netlist,
        or an analysis does not fit the deck.
    CircuitError
        If the netlist has no operating point.
    """
    target = _checked_target(Path(path))
    if form not in FORMS:
        raise InputError(f"form = {form!r} is unknown; choose one of {', '.join(FORMS)}")
    content, after, point = _content(netlist, target.name, dialect, title, form, tile, analyses, operating_point)
    found = expect(content.flat, point)
    rules = content.flat.dialect
    texts = {f"{target.name}.{suffix}": text for suffix, text in content.parts.items()}
    texts[f"{target.name}.{rules.name}"] = _commands(target.name, content.flat, analyses, after)
    checks = len(found.voltage) + len(found.source_current) + len(content.resistors)
    if verify and rules.name == "ngspice" and not _is_random(analyses) and checks <= companion.LARGEST:
        texts[f"{target.name}.verify"] = companion.format_companion(
            target.name, found, content.resistors, content.values, _hash(content.text)
        )
    more = _more(form, tile, texts, analyses, expected, scene_sha256)
    if form == "cells" and operating_point is not None:
        more["difference_from_flat"] = _difference(operating_point, point)
    sidecar = sidecar_path(target)
    texts[sidecar.name] = format_sidecar(target.name, content.flat, found, text=content.text, more=more)
    texts[target.name] = content.text
    _write_all(target, texts)
    return WrittenDeck(
        path=target,
        commands=target.with_name(f"{target.name}.{rules.name}"),
        sidecar=sidecar,
        sha256=_hash(content.text),
        companion=_beside(target, "verify", texts),
        chip=_beside(target, "chip", texts),
        pattern=_beside(target, "pattern", texts),
    )


def _checked_target(target: Path) -> Path:
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise InputError(f"cannot write a deck to {target}: its sidecar needs a place beside it; name a file")
    if '"' in target.name or not target.name.isprintable():
        raise InputError(f"cannot write a deck to {str(target)!r}: simulators cannot include a file of that name")
    return target


def _content(
    netlist: Netlist,
    name: str,
    dialect: str,
    title: str | None,
    form: Form,
    tile: Tile,
    analyses: Sequence[Analysis],
    point: OperatingPoint | None,
) -> tuple[_Content, Netlist | None, OperatingPoint]:
    """The deck, the scene after a change, and the operating point of what is written."""
    transient: TransientAnalysis | None = only_one(analyses, TransientAnalysis)
    mismatch: MismatchAnalysis | None = only_one(analyses, MismatchAnalysis)
    after = None if transient is None else transient.after
    if form == "cells":
        if after is not None:
            after = expanded_netlist(after, tile, mismatch)
        written = expanded_netlist(netlist, tile, mismatch)
        asked = additions(analyses, written, dialect_named(dialect), after)
        cells = tile_deck(
            netlist,
            tile,
            dialect=dialect,
            title=title,
            chip_file=f"{name}.chip",
            pattern_file=f"{name}.pattern",
            mismatch=mismatch,
            suffix=asked.suffix.get("voltage source"),
        )
        return _of_cells(cells), after, _solution(cells.flat.netlist)
    if mismatch is not None and not mismatch.runs:
        netlist, point = mismatch.apply(netlist), None
        after = None if after is None else mismatch.apply(after)
    asked = additions(analyses, netlist, dialect_named(dialect), after)
    flat = flatten(netlist, dialect=dialect, title=title, additions=asked)
    point = _solution(netlist) if point is None else point
    return _Content(flat, flat.text, flat.resistors, flat.resistor_value, {}), after, point


def _of_cells(deck: CellDeck) -> _Content:
    parts = {"chip": deck.chip, "pattern": deck.pattern}
    return _Content(deck.flat, deck.text, deck.resistors, deck.resistor_value, parts)


def _commands(name: str, deck: FlatDeck, analyses: Sequence[Analysis], after: Netlist | None) -> str:
    if analyses and not all(isinstance(item, MismatchAnalysis) and not item.runs for item in analyses):
        return format_analyses(name, deck, analyses, after)
    source, volts = "", ""
    if deck.source_names:
        source, volts = deck.source_names[0], repr(float(deck.netlist.source_volts[deck.sources[0]]))
    return deck.dialect.commands.format(deck=name, source=source, volts=volts)


def _is_random(analyses: Sequence[Analysis]) -> bool:
    mismatch: MismatchAnalysis | None = only_one(analyses, MismatchAnalysis)
    return mismatch is not None and mismatch.runs > 0


def _more(
    form: Form,
    tile: Tile,
    texts: Mapping[str, str],
    analyses: Sequence[Analysis],
    expected: Mapping[str, Any] | None,
    scene_sha256: str | None,
) -> dict[str, Any]:
    """Keys of the sidecar that only some decks need."""
    hashes = {name: _hash(text) for name, text in texts.items()}
    parts = {name: hash_ for name, hash_ in hashes.items() if name.endswith((".chip", ".pattern"))}
    more: dict[str, Any] = {"companions": {name: hash_ for name, hash_ in hashes.items() if name not in parts}}
    if form == "cells":
        more |= {"form": form, "tile": asdict(tile), "files": parts}
    if analyses:
        more["analyses"] = [_told(item) for item in analyses]
    if expected is not None:
        more["expected"] = _checked_json(expected)
    if scene_sha256 is not None:
        more["scene_sha256"] = scene_sha256
    return more


def _difference(flat: OperatingPoint, tiled: OperatingPoint) -> float:
    """Largest difference of a free cell's voltage between a flat netlist and its tiles, in volts."""
    ideal, real = flat.netlist.cells, tiled.netlist.cells
    cells = np.isin(ideal.node, ideal.free_node)
    difference = np.abs(flat.voltage[ideal.node[cells]] - tiled.voltage[real.node[cells]])
    return float(np.max(difference[np.isfinite(difference)], initial=0.0))


def _told(analysis: Analysis) -> dict[str, Any]:
    if isinstance(analysis, TransientAnalysis):
        changed = analysis.after is not None
        return {"kind": "transient", "stop": analysis.stop, "step": analysis.step, "changes_scene": changed}
    return {"kind": kind_of(analysis), **asdict(analysis)}


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


def _solution(netlist: Netlist) -> OperatingPoint:
    from resgrid.nodal.solve import solve

    return solve(netlist)
