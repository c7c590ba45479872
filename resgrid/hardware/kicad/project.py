"""The project file and the library tables of a KiCad project."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from resgrid.hardware.kicad.footprints import LIBRARY
from resgrid.hardware.kicad.sexpr import Node, format_tree

RULES = {
    "min_clearance": 0.15,
    "min_connection": 0.15,
    "min_copper_edge_clearance": 0.5,
    "min_hole_clearance": 0.25,
    "min_hole_to_hole": 0.25,
    "min_silk_clearance": 0.0,
    "min_text_height": 0.8,
    "min_text_thickness": 0.12,
    "min_through_hole_diameter": 0.3,
    "min_track_width": 0.15,
    "min_via_annular_width": 0.13,
    "min_via_diameter": 0.5,
}
"""Design rules by KiCad's name, in millimetres; all usual manufacturers of boards with two layers meet them."""

_ERRORS_OF_BOARD = (
    "annular_width", "clearance", "copper_edge_clearance", "copper_sliver", "courtyards_overlap",
    "drill_out_of_range", "duplicate_footprints", "extra_footprint", "footprint", "footprint_symbol_mismatch",
    "hole_clearance", "hole_near_hole", "holes_co_located", "invalid_outline", "isolated_copper",
    "item_on_disabled_layer",
    "items_not_allowed", "lib_footprint_issues", "lib_footprint_mismatch", "malformed_courtyard", "missing_footprint",
    "net_conflict", "npth_inside_courtyard", "pth_inside_courtyard", "shorting_items", "silk_edge_clearance",
    "silk_over_copper", "silk_overlap", "solder_mask_bridge", "starved_thermal", "text_height", "text_on_edge_cuts",
    "text_thickness", "track_dangling", "track_width", "tracks_crossing", "unconnected_items", "via_dangling",
    "zones_intersect",
)  # fmt: skip
"""KiCad's names of the violations of design rules that the project treats as errors."""

_ERRORS_OF_SCHEMATIC = (
    "bus_entry_needed", "different_unit_net", "duplicate_reference", "endpoint_off_grid", "footprint_link_issues",
    "hier_label_mismatch", "isolated_pin_label", "label_dangling", "label_multiple_wires", "lib_symbol_issues",
    "lib_symbol_mismatch", "multiple_net_names", "net_not_bus_member", "no_connect_connected", "no_connect_dangling",
    "pin_not_connected", "pin_not_driven", "pin_to_pin", "power_pin_not_driven", "similar_labels",
    "simulation_model_issue", "unconnected_wire_endpoint", "unannotated", "unresolved_variable",
    "wire_dangling",
)  # fmt: skip
"""KiCad's names of the violations of electrical rules that the project treats as errors."""


def format_project(name: str, sheets: Sequence[tuple[str, str]]) -> str:
    """Return the text of a project file (``.kicad_pro``).

    `name`: name of the project; `sheets`: UUID and title of every sheet, the root first.
    """
    board = dict.fromkeys(_ERRORS_OF_BOARD, "error")
    schematic = dict.fromkeys(_ERRORS_OF_SCHEMATIC, "error")
    data: dict[str, Any] = {
        "board": {
            "design_settings": {
                "defaults": {"silk_text_size_h": 0.8, "silk_text_size_v": 0.8, "silk_text_thickness": 0.12},
                "rule_severities": board,
                "rules": RULES,
            }
        },
        "boards": [],
        "erc": {"meta": {"version": 0}, "rule_severities": schematic},
        "libraries": {"pinned_footprint_libs": [LIBRARY], "pinned_symbol_libs": [LIBRARY]},
        "meta": {"filename": f"{name}.kicad_pro", "version": 3},
        "net_settings": {
            "classes": [
                {
                    "clearance": 0.2,
                    "name": "Default",
                    "priority": 2147483647,
                    "track_width": 0.25,
                    "via_diameter": 0.8,
                    "via_drill": 0.4,
                }
            ],
            "meta": {"version": 4},
        },
        "schematic": {"meta": {"version": 1}},
        "sheets": [list(sheet) for sheet in sheets],
        "text_variables": {},
    }
    return json.dumps(data, indent=2, sort_keys=True) + "\n"


def format_footprint_table() -> str:
    """Return the text of the table of footprint libraries: the project's own library only."""
    return format_tree(_table("fp_lib_table", f"{LIBRARY}.pretty", "Footprints of this board"))


def format_symbol_table() -> str:
    """Return the text of the table of symbol libraries: the project's own library only."""
    return format_tree(_table("sym_lib_table", f"{LIBRARY}.kicad_sym", "Symbols of this board"))


def _table(keyword: str, file: str, about: str) -> Node:
    """Return the S-expression of a table with one library.

    `keyword`: KiCad's word for the table; `file`: name of the library in the project's folder; `about`: its
    description.
    """
    library: Node = [
        "lib", ["name", LIBRARY], ["type", "KiCad"], ["uri", "${KIPRJMOD}/" + file], ["options", ""], ["descr", about],
    ]  # fmt: skip
    return [keyword, ["version", 7], library]
