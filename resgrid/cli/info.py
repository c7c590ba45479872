"""``resgrid info``: describe a scene or a deck, the scene format, shipped scenes, and installed versions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid._internal.coordinates import span_text
from resgrid.cli.arms import verdict_data, verdict_lines
from resgrid.cli.decks import deck_data, is_deck, open_deck
from resgrid.cli.options import CommandInput, subcommand, with_source
from resgrid.cli.scenes import Job, free_counts, open_job, place_of, report_ignored, several_k, size_of
from resgrid.cli.streams import STANDARD_INPUT
from resgrid.cli.terminal import counted, finish
from resgrid.errors import CircuitError, InputError, ToolMissingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from resgrid.spice.circuit import Circuit

DEPENDENCIES = ("numpy", "scipy", "numba", "networkx", "shapely", "matplotlib", "pydantic", "click", "rich")


@subcommand(
    "info",
    examples=("resgrid info map.yaml", "resgrid info theirs.sp --json", "resgrid info --examples"),
)
@with_source("[SCENE|DECK]", required=False)
@click.option("--schema", is_flag=True, help="Print the JSON Schema of scene files.")
@click.option("--examples", "shipped", is_flag=True, help="List the shipped scenes, which can be given by name.")
@click.option("--versions", is_flag=True, help="Print the versions of resgrid and its dependencies.")
def command(source: CommandInput | None, schema: bool, shipped: bool, versions: bool) -> int:
    """Describe SCENE: a sketch, its cells, goals and starts, unreachable cells, and the memory of a solution.

    For a map, also how it was read, such as the grey values of free cells; a goal is not necessary.

    For a DECK: its elements, values and supplies, notes of its reader, and the estimated time of ngspice.
    """
    if (source is not None) + schema + shipped + versions != 1:
        raise InputError("give exactly one of: a SCENE or DECK, --schema, --examples, --versions")
    if schema:
        click.echo(json.dumps(rg.scene_schema(), indent=2))
    elif shipped:
        listed = shipped_data()
        finish({"examples": listed}, _shipped_lines(listed))
    elif versions:
        data = installed_versions()
        finish({"versions": data}, (f"{name:12} {version or 'not installed'}" for name, version in data.items()))
    elif source is not None and is_deck(source):
        data = describe_deck(open_deck(source))
        finish(data, _deck_lines(data))
    elif source is not None:
        job = open_job(source, require_goal=False)
        data = describe(job) | report_ignored(job, "grid", k=several_k(job.scene))
        finish(data, _lines(data))
    return 0


def describe(job: Job) -> dict[str, Any]:
    """Return the description of a scene as a dictionary for JSON.

    Keys: the scene's keys such as ``title``, ``axes`` and ``starts``; ``map``: dictionary on how the map was read, None
    without a map; ``sketch`` (rows of letters), ``sketch_lower``, ``sketch_upper`` (corners of the shown part, in axis
    units) and ``sketch_key`` (meaning of the letters), None unless there are two axes; numbers of cells, such as
    ``free_cells``, and of ``goals``; ``verdicts`` (numbers of proven cells) for an arm in space; ``nodes``,
    ``resistors`` and ``memory_bytes`` of the circuit, or the reason ``no_circuit``.
    """
    from resgrid.cli.sketch import sketch
    from resgrid.scene.maps.formats import describe_map
    from resgrid.scene.world_coordinates import unknown_cells

    scene, space = job.scene, job.space
    starts = [scene.frame.from_world(start).tolist() for start in scene.starts]
    drawn = sketch(space, starts, unknown_cells(scene.map, space.axes)) if space.ndim == 2 else None
    return {
        "title": scene.title,
        "source": scene.source,
        "shape": list(space.shape),
        "axes": [
            {key: getattr(axis, key) for key in ("name", "lower", "upper", "cells", "spacing", "periodic", "unit")}
            for axis in space.axes
        ],
        "frame": {key: getattr(scene.frame, key) for key in ("x", "y", "yaw")},
        "map": None if scene.map is None else describe_map(scene.map) | _name_of_input(scene),
        "masks": [{"file": mask.file, "kind": mask.kind} for mask in scene.mask],
        "sketch": None if drawn is None else drawn.rows,
        "sketch_lower": None if drawn is None else list(drawn.lower),
        "sketch_upper": None if drawn is None else list(drawn.upper),
        "sketch_key": None if drawn is None else drawn.key,
        "cells": space.cell.size,
        **free_counts(space),
        **verdict_data(job),
        "obstacle_cells": int((space.cell == rg.Cell.OBSTACLE).sum()),
        "goal_cells": int((space.cell == rg.Cell.GOAL).sum()),
        "goals": space.goal_count,
        "starts": [list(start) for start in scene.starts],
        "boundary": scene.boundary,
        "drive": scene.drive,
        "leak": scene.leak,
        "edge": list(scene.edge),
        "lattice": scene.lattice,
        "k": list(scene.k),
        **_cost(job),
    }


def _name_of_input(scene: rg.Scene) -> dict[str, str]:
    """Return the entry ``file`` of a map from standard input, which was copied to a temporary file; else no entry."""
    return {"file": STANDARD_INPUT} if scene.source == STANDARD_INPUT else {}


def _cost(job: Job) -> dict[str, Any]:
    """Return the size of the circuit as a dictionary for JSON: ``nodes``, ``resistors`` and ``memory_bytes``.

    ``memory_bytes`` is the estimated memory of a solution. If the scene has no goal, or several circuits, the values
    are None, and the key ``no_circuit`` holds the reason as text.
    """
    from resgrid.circuit.equations import assemble
    from resgrid.scene.sampling import with_coordinates
    from resgrid.solvers.method_choice import choose_method

    if not job.space.goal_count:
        reason = f"no goal; give {with_coordinates('--goal', job.space.ndim)}"
        return {"nodes": None, "resistors": None, "memory_bytes": None, "no_circuit": reason}
    try:
        netlist = job.compile(job.problem.only_wiring()[1], ideal=True, scaled=False)
        system = assemble(netlist)
        memory = choose_method(system.laplacian).memory if system.size else 0
    except (CircuitError, InputError) as error:
        return {"nodes": None, "resistors": None, "memory_bytes": None, "no_circuit": str(error)}
    return {"nodes": netlist.node_count, "resistors": len(netlist.conductance), "memory_bytes": memory}


def describe_deck(deck: Circuit) -> dict[str, Any]:
    """Return the description of a deck as a dictionary for JSON.

    Keys: those of `deck_data` (``source``, ``title``, ``nodes``, numbers of elements and so on);
    ``smallest_resistance`` and ``largest_resistance``: range of the resistances above 0, in ohms, None without one;
    ``shorts``: number of resistors of 0 ohm and sources of 0 V; ``supply_volts``: different source voltages except 0 in
    volts, ascending, at most the 100 lowest; ``floating_nodes``: number of nodes without a conducting path to ground;
    ``ngspice_seconds`` and ``ngspice_memory_bytes``: estimated cost of a simulation.
    """
    import numpy as np

    from resgrid.spice.run.cost_estimate import forecast

    ohms = deck.resistance[deck.resistance > 0]
    run = forecast(deck)
    return {
        **deck_data(deck),
        "smallest_resistance": float(ohms.min()) if ohms.size else None,
        "largest_resistance": float(ohms.max()) if ohms.size else None,
        "shorts": int((deck.resistance == 0).sum() + (deck.source_volts == 0).sum()),
        "supply_volts": np.unique(deck.source_volts[deck.source_volts != 0])[:100].tolist(),
        "floating_nodes": int((deck.part != deck.part[0]).sum()),
        "ngspice_seconds": run.seconds,
        "ngspice_memory_bytes": run.memory,
    }


def _deck_lines(data: dict[str, Any]) -> Iterable[str]:
    yield f"{data['title'] or data['source']}: a deck read as {data['dialect']}"
    for file in data["files"][1:]:
        yield f"  includes      {file}"
    yield f"  nodes         {data['nodes']:,}, of which {data['floating_nodes']:,} float"
    if data["smallest_resistance"] is not None:
        low, high = data["smallest_resistance"], data["largest_resistance"]
        yield f"  resistors     {data['resistors']:,} of {low:g} to {high:g} ohm"
    yield f"  sources       {data['voltage_sources']:,} of voltage, {data['current_sources']:,} of current"
    yield f"  shorts        {data['shorts']:,} (sources of 0 V, resistors of 0 ohm)"
    yield f"  capacitors    {data['capacitors']:,}"
    if data["supply_volts"]:
        volts = ", ".join(f"{volts:g}" for volts in data["supply_volts"][:5])
        yield f"  supplies      {volts}{', ...' if len(data['supply_volts']) > 5 else ''} V"
    yield f"  ngspice       about {data['ngspice_seconds']:.2g} s, {data['ngspice_memory_bytes'] / 2**20:,.0f} MiB"
    yield f"  notes         {len(data['notes']):,}"
    for note in data["notes"][:5]:
        yield f"    {note['severity']}: {note['file']}:{note['line']}: {note['text']}"


def shipped_data() -> list[dict[str, Any]]:
    """Return a list with one dictionary for JSON per shipped scene, with the keys ``name``, ``title`` and ``file``."""
    import tomllib

    from resgrid.scene.shipped import shipped_scenes

    return [
        {"name": name, "title": tomllib.loads(file.read_text(encoding="utf-8")).get("title", ""), "file": str(file)}
        for name, file in shipped_scenes().items()
    ]


def _shipped_lines(data: Sequence[dict[str, Any]]) -> Iterable[str]:
    width = max((len(row["name"]) for row in data), default=0)
    yield from (f"{row['name']:{width}}  {row['title']}" for row in data)
    if data:
        folder = Path(data[0]["file"]).parent
        yield f"use a scene by its name, such as 'resgrid run {data[0]['name']}'; the files are in {folder}"


def installed_versions() -> dict[str, str | None]:
    """Return the versions as texts, by name: ``resgrid``, ``python``, all dependencies, and ``ngspice``.

    The version of ngspice is None if ngspice is not installed.
    """
    import platform
    from importlib import metadata

    versions: dict[str, str | None] = {"resgrid": metadata.version("resgrid"), "python": platform.python_version()}
    versions |= {name: metadata.version(name) for name in DEPENDENCIES}
    try:
        from resgrid.spice.run.ngspice import ngspice_version

        versions["ngspice"] = ngspice_version()
    except ToolMissingError:
        versions["ngspice"] = None
    return versions


_ROWS = "its top row at the largest y: y points up"
"""Text of the report on the order of the cells in a map that is a picture or has rows of text."""

_ORDERS = {
    "npy": "its first index along x: y points up",
    "voxels": "its first index along x: y points up",
    "octomap": "in the coordinates of the file",
    "point_cloud": "voxels that contain a point, in the coordinates of the file",
}
"""Texts of the report on the order or the coordinates of the cells in other maps, by name of the format."""


def _map_lines(data: dict[str, Any]) -> Iterable[str]:
    """Yield the lines of text that state how a map was read.

    `data`: result of `describe`, whose key ``map`` is not None.
    """
    words = data["map"] or {}
    if words:
        reader = f" as {words['dialect']} reads it (--map-dialect)" if "dialect" in words else ""
        yield f"  map           {words['format']}{reader}, {_ORDERS.get(words['format'], _ROWS)}"
    prepared = [f"--{key} {_option_text(words[key])}" for key in ("crop", "coarsen", "refine") if key in words]
    if prepared:
        yield f"  prepared      {', then '.join(prepared)}"
    if "greys" in words:
        option = " (--threshold)" if words["format"] == "image" else ""
        yield "  grey          " + ", ".join(f"{low} to {high} {kind}" for low, high, kind in words["greys"]) + option
    if "unknown_cells" in words:
        yield f"  unknown       {words['unknown_cells']:,} cells, read as {words['unknown_as']} (--unknown)"
    if "passable" in words:
        yield f"  passable      {words['passable']} (--passable)"
    frame = data["frame"]
    if any(frame.values()):
        yield f"  frame         origin at {place_of((frame['x'], frame['y']))}, rotated by {frame['yaw']:g} rad"


def _option_text(value: Any) -> str:
    """Return the value of an option that crops or joins cells as on the command line: numbers separated by commas."""
    return ",".join(f"{part:.15g}" for part in value) if isinstance(value, list | tuple) else str(value)


def _sketch_lines(data: dict[str, Any]) -> Iterable[str]:
    """Yield the lines of text with the sketch of a space, after the meaning of its letters and its range.

    `data`: result of `describe`, whose key ``sketch`` is not None.
    """
    across, up = data["axes"]
    whose = " in the map's own frame" if data["frame"]["yaw"] else ""
    yield f"  sketch        {across['name']} to the right, {up['name']} upwards{whose}: {data['sketch_key']}"
    shown = list(zip(data["axes"], data["sketch_lower"], data["sketch_upper"], strict=True))
    if any((axis["lower"], axis["upper"]) != (low, high) for axis, low, high in shown):
        part = ", ".join(f"{axis['name']} {span_text(low, high)} {axis['unit']}" for axis, low, high in shown)
        yield f"                only the known part: {part}; all other cells are unknown"
    yield from (f"    {row}" for row in data["sketch"])


def _lines(data: dict[str, Any]) -> Iterable[str]:
    yield f"{data['title'] or data['source']}: {size_of(data['shape'])} = {data['cells']:,} cells"
    for axis in data["axes"]:
        ring = ", periodic" if axis["periodic"] else ""
        yield (
            f"  {axis['name']}: {span_text(axis['lower'], axis['upper'])} {axis['unit']}, "
            f"{axis['cells']} cells of {axis['spacing']:.6g} {axis['unit']}{ring}"
        )
    yield from _map_lines(data)
    for number, mask in enumerate(data["masks"]):
        yield f"  mask[{number}]       {mask['kind']}, {mask['file']}"
    if data["sketch"] is not None:
        yield from _sketch_lines(data)
    lost = f", of which {data['unreachable_cells']:,} are not connected with a goal" if data["goals"] else ""
    yield from (f"  {line}" for line in verdict_lines(data))
    yield f"  free          {data['free_cells']:,}{lost}"
    yield f"  obstacle      {data['obstacle_cells']:,}"
    regions = f" in {counted(data['goals'], 'region')}" if data["goals"] else ""
    yield f"  goal          {data['goal_cells']:,}{regions}"
    yield f"  starts        {len(data['starts'])}"
    drive = f", drive {data['drive']}" if data["drive"] else f", leak {data['leak']:g}" if data["leak"] else ""
    lattice = "" if data["lattice"] == "square" else f", lattice {data['lattice']}"
    yield f"  boundary      {data['boundary']}{drive}, edge {', '.join(data['edge'])}{lattice}"
    if data["memory_bytes"] is None:
        yield f"  no circuit    {data['no_circuit']}"
    else:
        yield f"  circuit       {data['nodes']:,} nodes, {data['resistors']:,} resistors"
        yield f"  memory        about {data['memory_bytes'] / 2**20:,.0f} MiB to solve"
