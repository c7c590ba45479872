"""Export of a drawing: as a scene file, a table of paths, a picture or SPICE decks."""

from __future__ import annotations

import io
import json
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from resgrid.chip.build import build_chip
from resgrid.errors import InputError
from resgrid.io.paths import Route, write_routes
from resgrid.live_page.drawing import Drawing
from resgrid.live_page.frames import MAX_CIRCUIT_SIDE
from resgrid.live_page.solving import imperfections_of, solve_drawing
from resgrid.planning.pipeline import compile_circuit
from resgrid.spice.write.files import write_spice


def save(drawing: Drawing, kind: str | None) -> tuple[str, bytes]:
    """Return the name and the content of an exported file; raise InputError for another `kind`, or None.

    `kind`: ``toml`` or ``json`` (the scene), ``csv`` (paths), ``deck`` (SPICE decks with sidecars, zipped), ``svg``
    (picture of field and paths, drawn by `rg.draw`) or ``circuit`` (picture of the circuit as SVG, up to 10 cells per
    axis).
    """
    match kind:
        case "toml":
            drawing.scene()
            return "scene.toml", scene_toml(drawing.document()).encode()
        case "json":
            drawing.scene()
            return "scene.json", json.dumps(drawing.document(), separators=(",", ":"), sort_keys=True).encode()
        case "csv":
            return "paths.csv", _paths(drawing)
        case "deck":
            return "deck.zip", _deck(drawing)
        case "svg":
            return "resgrid.svg", _picture(drawing)
        case "circuit":
            return "circuit.svg", _circuit(drawing)
    raise InputError(f"there is no format {kind!r}; the formats are toml, json, csv, deck, svg and circuit")


def scene_toml(document: Mapping[str, Any]) -> str:
    """Return a document (keys and tables of a scene) as TOML text: keys, then tables, then lists of tables.

    Examples
    --------
    >>> print(scene_toml({"schema": 1, "goal": [{"cell": [3, 4]}]}), end="")
    schema = 1
    <BLANKLINE>
    [[goal]]
    cell = [3, 4]
    """
    lines = [f"{key} = {_value(value)}" for key, value in document.items() if not _is_table(value)]
    for key, value in document.items():
        if not _is_table(value):
            continue
        for table in value if isinstance(value, list) else [value]:
            lines += ["", f"[[{key}]]" if isinstance(value, list) else f"[{key}]"]
            lines += [f"{name} = {_value(entry)}" for name, entry in table.items()]
    return "\n".join(lines) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_value(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)


def _paths(drawing: Drawing) -> bytes:
    frame = solve_drawing(drawing, exact=True)
    routes = [Route(path, tuple(path.points[0].tolist())) for path in frame.paths if path is not None]
    if not routes:
        raise InputError("there is no start, and therefore no path to save: set a start with the start tool")
    with tempfile.TemporaryDirectory() as folder:
        write_routes(routes, Path(folder) / "paths.csv")
        return (Path(folder) / "paths.csv").read_bytes()


def _picture(drawing: Drawing) -> bytes:
    """Return the bytes of an SVG picture of the field and the certified paths."""
    from resgrid.plot.figures import render_figure
    from resgrid.plot.pictures import draw

    frame = solve_drawing(drawing, exact=True)
    axes = draw(frame.field)
    paths = [path for path in frame.paths if path is not None]
    return render_figure(draw(paths, axes) if paths else axes, "svg")


def _circuit(drawing: Drawing) -> bytes:
    """Return the bytes of an SVG picture of the circuit of a drawing with its voltages.

    Raises InputError for a blend, and for a grid of more than 10 cells along an axis.
    """
    from resgrid.plot.figures import render_figure
    from resgrid.plot.pictures import draw

    points = list(solve_drawing(drawing, exact=True).solution.operating_points.values())
    if len(points) != 1:
        raise InputError("a blend consists of two chips: choose k = 0 or k = 1 for the circuit of one chip")
    if max(drawing.cell.shape) > MAX_CIRCUIT_SIDE:
        raise InputError(
            f"circuits are only drawn for up to {MAX_CIRCUIT_SIDE} cells per axis; this grid has "
            f"{' x '.join(map(str, drawing.cell.shape))}"
        )
    return render_figure(draw(points[0]), "svg")


def _deck(drawing: Drawing) -> bytes:
    """Return the bytes of a ZIP archive with the SPICE decks of the drawing's circuits and their sidecars.

    The circuits include the mismatch and the open resistors of the chip.
    """
    problem = drawing.problem
    content = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder:
        for name, wiring in problem.wirings.items():
            netlist = build_chip(compile_circuit(problem.space, wiring), imperfections_of(drawing))
            write_spice(netlist, Path(folder) / f"{name}.cir", title=drawing.title or name)
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(Path(folder).iterdir()):
                archive.write(file, file.name)
    return content.getvalue()
