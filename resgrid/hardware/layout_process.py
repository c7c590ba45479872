"""Conversion of the data of a chip process to the design rules of layouts, in nanometres."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from resgrid.errors import InputError
from resgrid.hardware.layout_rules import Cover, Layer, LayoutRules, MetalRules
from resgrid.processes.process import Cut, Process
from resgrid.processes.reading import read_process

WIDE = 10.0
"""Largest width of metal shapes, in micrometres, for which the spacing in `MetalRules` suffices."""

SHEET = 0.1
"""Assumed sheet resistance of a metal whose process states none, in ohms per square."""

METALS = 3
"""Smallest number of metals that a process needs for a layout: nodes, the obstacle rail, and trunks of goals."""


@cache
def layout_rules(name: str) -> LayoutRules:
    """Return the design rules of a process and its resistor.

    `name`: name such as ``"ihp-sg13g2:rppd"``.  Raises InputError if the process is unknown, or its data lack a layer
    that a layout needs.
    """
    process = read_process(name)
    resistor, contact = process.resistor, process.cuts["contact"]
    pad = process.pad
    metals = _metals(process)
    return LayoutRules(
        process=name,
        resistor=resistor,
        grid=_nm(process.grid),
        body={layer: _layer(process, layer) for layer in resistor.body},
        ends={layer: _layer(process, layer) for layer in resistor.ends},
        contact=_layer(process, "contact"),
        width=_nm(resistor.min_width),
        body_length=_nm(resistor.min_length),
        space=_nm(resistor.min_space),
        width_offset=_nm(resistor.width_correction),
        head=_nm(resistor.head_length),
        body_covers=tuple(_cover(process, layer, *overlaps) for layer, overlaps in resistor.body_covers.items()),
        covers=tuple(_cover(process, layer, *overlaps) for layer, overlaps in resistor.covers.items()),
        contact_size=_nm(contact.size),
        contact_space=_nm(contact.space),
        contact_enclosure=_nm(contact.enclosure_below),
        contact_distance=_nm(resistor.contact_distance),
        contact_metal=_nm(contact.enclosure_above),
        metals=metals,
        pad=_nm(pad.size),
        pad_space=_nm(pad.space),
        pad_opening=_nm(pad.opening_enclosure),
        pad_layers=tuple(_layer(process, layer) for layer in pad.layers if layer != metals[-1].name),
        passivation=None if pad.opening is None else _layer(process, pad.opening),
        outline=_layer(process, "outline"),
    )


def _nm(micrometres: float) -> int:
    """Return a length in whole nanometres; `micrometres`: the length."""
    return round(1e3 * micrometres)


def _layer(process: Process, name: str) -> Layer:
    """Return the GDSII numbers of a layer; raise InputError if the process lacks the layer."""
    if name not in process.layers:
        raise InputError(f"{process.title} has no layer {name!r}, which a layout needs; add it to the process's file")
    return process.layers[name].gds


def _cover(process: Process, name: str, beside: float, beyond: float) -> Cover:
    """Return the rules of a layer that covers resistors, in nanometres.

    `name`: name of the layer in the process; `beside`, `beyond`: distances by which the layer extends past a resistor
    across and along the current, in micrometres.
    """
    layer = process.layers[name]
    width, space = _nm(layer.min_width or 0.0), _nm(layer.min_space or 0.0)
    return Cover(name, layer.gds, _nm(beside), _nm(beyond), width, space)


def _metals(process: Process) -> tuple[MetalRules, ...]:
    """Return the rules of the metals of a process, from the lowest metal up to the metal of the pads.

    Raises InputError if there are fewer than three metals, or if vias do not connect them up to the pads.
    """
    upward = {cut.below: (name, cut) for name, cut in process.cuts.items()}
    metal, metals = process.cuts["contact"].above, []
    while True:
        via = upward.get(metal) if metal not in process.pad.layers else None
        metals.append(_metal(process, metal, *(via or ("", None))))
        if via is None:
            break
        metal = via[1].above
    if len(metals) < METALS or metal not in process.pad.layers:
        raise InputError(
            f"{process.title} connects {len(metals)} metals up to {metal!r}, and a layout needs {METALS} and pads on "
            "the highest one; add the cuts between them to the process's file"
        )
    return tuple(metals)


def _metal(process: Process, name: str, via: str, cut: Cut | None) -> MetalRules:
    """Return the rules of the metal `name`.

    `via`: name of the layer of the vias to the next metal above, empty for the highest metal; `cut`: rules of these
    vias, None for the highest metal. The spacing of the metal holds for shapes of at most 10 micrometres width, and the
    spacing of the vias for arrays of every size.
    """
    layer = process.layers[name]
    label = next((label for label in (f"{name}_label", "label") if label in process.layers), name)
    rules = MetalRules(
        name=name,
        layer=layer.gds,
        text=process.layers[label].gds,
        width=_nm(layer.min_width or 0.0),
        space=_nm(process.min_space(name, WIDE) or 0.0),
        sheet=layer.sheet_resistance or SHEET,
        area=round(1e6 * (layer.min_area or 0.0)),
        current=layer.current_density,
    )
    if cut is None:
        return rules
    return replace(
        rules,
        via=via,
        via_layer=_layer(process, via),
        via_size=_nm(cut.size),
        via_space=_nm(cut.array_space or cut.space),
        via_enclosure=_nm(max(cut.enclosure_below, cut.enclosure_above)),
    )
