"""What each simulator makes of circuits that are not quite sound, as data.

ngspice's habits were measured with version 39 (`tests/spice/test_verdicts.py` measures them again); version 46 has them
too:

- One floating part makes the matrix singular; the answer that comes back, with exit status 0, is that of a circuit with
  ``gmin`` (``.option gshunt`` or else ``.option gmin``, 1e-12 S without) from *every* node to ground.
- ``.option rshunt=R`` puts ``R`` from every node to ground.
- 0 ohm becomes 1 milliohm (1e-12 ohm, with a warning, in version 45); smaller but positive values are kept.
- The first line is the title, whatever it says.
- A second device of the same name, or a loop of voltage sources that ground is tied to, ends the run without an answer;
  a loop elsewhere is mostly answered rightly, but not always.
- A loop of inductors, or of inductors and sources, makes the matrix singular: the answer is what a transient comes to,
  which depends on their inductances and may be anything.
- Where a resistance is far smaller than everything else that holds its nodes, their difference drowns in its
  conductance: 1e-9 ohm behind 5 ohm costs a millionth of the voltage.

The others are told from their manuals and mailing lists, without having been run: HSPICE raises resistances to
``RESMIN`` (1e-5 ohm); Spectre and HSPICE put ``gmin`` at the floating nodes only, and say so; all of them take the
first line for the title and refuse loops of voltage sources.  What is not known is not claimed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Basis = Literal["measured", "documented"]


@dataclass(frozen=True)
class Habits:
    """What one simulator does.

    `basis`: how this is known; `smallest_resistance`: in ohms: what smaller resistances are raised to, 0 included;
    None where that is not known; `raises_zero_only`: positive values are kept; `floating`: where a conductance is
    added when a part floats: at every node, at the floating nodes, or nobody knows; `gmin`: that conductance, in
    siemens; `gmin_options`: options that change it, those that count before others first; `shunt_options`: options
    that tie every node to ground; `duplicates`: what a second element of the same name leads to; `loops`: which loops
    of voltage sources leave no answer; other loops, and those of inductors, leave it to a transient.
    """

    name: str
    basis: Basis
    smallest_resistance: float | None = None
    raises_zero_only: bool = False
    floating: Literal["everywhere", "there", "unknown"] = "unknown"
    gmin: float = 1e-12
    gmin_options: tuple[str, ...] = ("gmin",)
    shunt_options: Mapping[str, Literal["ohms", "siemens"]] = field(default_factory=dict)
    duplicates: Literal["fails", "unknown"] = "unknown"
    loops: Literal["fail", "fail at ground"] = "fail"


HABITS: tuple[Habits, ...] = (
    Habits(
        name="ngspice",
        basis="measured",
        smallest_resistance=1e-3,
        raises_zero_only=True,
        floating="everywhere",
        shunt_options={"rshunt": "ohms"},
        duplicates="fails",
        gmin_options=("gshunt", "gmin"),
        loops="fail at ground",
    ),
    Habits(name="ltspice", basis="documented", shunt_options={"gshunt": "siemens"}, duplicates="fails"),
    Habits(name="xyce", basis="documented"),
    Habits(
        name="hspice",
        basis="documented",
        smallest_resistance=1e-5,
        floating="there",
        shunt_options={"gshunt": "siemens"},
    ),
    Habits(name="spectre", basis="documented", floating="there"),
)
"""One entry a simulator."""
