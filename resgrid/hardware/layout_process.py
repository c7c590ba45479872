"""Design rules of the processes in which layouts are drawn.

Values of IHP SG13G2 are those of its open design kit (IHP-Open-PDK, Apache-2.0): layers, the rules of
``sg13g2_tech_default.json``, and the models ``rppd`` and ``rhigh`` of ``resistors_mod.lib``.  Spacings are those of
wide metal (rules M1.e, Mn.e) and of arrays of vias (V1.b1, Vn.b1), so that they hold everywhere.  Sheet resistances of
metals are computed from their thickness in the kit with a resistivity of 0.045 uohm m, an assumption.
"""

from __future__ import annotations

from dataclasses import replace

from resgrid.errors import InputError, suggestion
from resgrid.hardware.layout_rules import LayoutRules, MetalRules

RESISTIVITY = 0.045e-6
"""Assumed resistivity of metals, in ohm metres."""

CURRENT = 1000.0
"""Assumed largest direct current per width of a metal, in A/m (mA/mm)."""


def layout_rules(process: str) -> LayoutRules:
    """Return the design rules of a process and its resistor; raise InputError for an unknown name."""
    if process not in RULES:
        known = ", ".join(RULES)
        raise InputError(f"there is no process {process!r}: {suggestion(process, list(RULES)) or f'there are {known}'}")
    return RULES[process]


def _ihp_metals() -> tuple[MetalRules, ...]:
    """Return the metals of IHP SG13G2; lengths in nanometres."""
    thin = [
        MetalRules(
            f"Metal{number}", (layer, 0), (layer, 25), 160 if number == 1 else 200, 220 if number == 1 else 240,
            RESISTIVITY / (0.42e-6 if number == 1 else 0.49e-6), 90_000 if number == 1 else 144_000, CURRENT,
            f"Via{number}", (via, 0), 190, 290, 50,
        )
        for number, layer, via in ((1, 8, 19), (2, 10, 29), (3, 30, 49), (4, 50, 66))
    ]  # fmt: skip
    fifth = replace(
        thin[1], name="Metal5", layer=(67, 0), text=(67, 25), via="TopVia1", via_layer=(125, 0), via_size=420,
        via_space=420, via_enclosure=420,
    )  # fmt: skip
    top_1 = MetalRules(
        "TopMetal1",
        (126, 0),
        (126, 25),
        1640,
        1640,
        RESISTIVITY / 2e-6,
        0,
        CURRENT,
        "TopVia2",
        (133, 0),
        900,
        1060,
        500,
    )
    return (
        *thin,
        fifth,
        top_1,
        MetalRules("TopMetal2", (134, 0), (134, 25), 2000, 2000, RESISTIVITY / 3e-6, 0, CURRENT),
    )


_RPPD = LayoutRules(
    process="ihp-sg13g2:rppd",
    grid=5,
    sheet=260.0,
    end_resistance=35e-6,
    corner_squares=1 / 1.85,
    width_offset=6,
    poly=(5, 0),
    marker=(28, 0),
    contact=(6, 0),
    width=500,
    body_length=500,
    poly_space=180,
    marker_width=420,
    marker_space=420,
    marker_enclosure=200,
    contact_size=160,
    contact_space=180,
    contact_enclosure=70,
    contact_marker=200,
    contact_metal=50,
    metals=_ihp_metals(),
    pad=70_000,
    pad_space=30_000,
    pad_opening=2100,
    passivation=(9, 0),
    outline=(189, 0),
    covers=(("pSD", (14, 0), 180, 310, 310), ("EXTBlock", (111, 0), 180, 310, 310)),
    matching=0.015e-6,
)

_RHIGH = replace(
    _RPPD,
    process="ihp-sg13g2:rhigh",
    sheet=1360.0,
    end_resistance=80e-6,
    width_offset=-40,
    covers=(*_RPPD.covers, ("nSD", (7, 0), 180, 310, 310)),
)


def _toy_metals() -> tuple[MetalRules, ...]:
    """Return three metals of a toy process; lengths in nanometres."""
    metals = [
        MetalRules(f"metal{n}", (2 + 2 * n, 0), (2 + 2 * n, 1), 400, 400, 0.08, 0, CURRENT, f"via{n}", (3 + 2 * n, 0),
                   300, 300, 100)
        for n in (1, 2, 3)
    ]  # fmt: skip
    return (*metals[:2], replace(metals[2], via=""))


_TOY = replace(
    _RPPD,
    process="toy",
    grid=10,
    sheet=1000.0,
    end_resistance=0.0,
    corner_squares=0.56,
    width_offset=0,
    poly=(1, 0),
    marker=(2, 0),
    contact=(3, 0),
    poly_space=500,
    marker_width=500,
    marker_space=500,
    contact_size=300,
    contact_space=300,
    contact_enclosure=100,
    contact_metal=100,
    metals=_toy_metals(),
    pad=60_000,
    pad_space=20_000,
    pad_opening=2000,
    passivation=(9, 0),
    outline=(10, 0),
    covers=(),
    matching=0.02e-6,
)

RULES = {rules.process: rules for rules in (_TOY, _RPPD, _RHIGH)}
"""Design rules by name of process and resistor."""
