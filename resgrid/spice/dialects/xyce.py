"""Dialect of Xyce as data: rules of its decks, from its guides; Xyce was not run.

- Expressions are written in braces, subcircuit parameters after ``PARAMS:``, in the definition and in every instance.
- Only quantities in a ``.PRINT`` statement are printed; an operating point is a ``.DC`` sweep of one step.
- ``gnd`` is an ordinary node, unless the deck has ``.PREPROCESS REPLACEGROUND TRUE``.
- ``TIME, FREQ, HERTZ, VT, TEMP, TEMPER, GMIN`` may not be names of parameters (Xyce Reference Guide, ".PARAM");
  ``PI`` and ``CTOK`` are tokens of its expressions (``src/UtilityPKG/ExpressionSrc/ExpressionLexer.l``).  A function is
  recognized only if a parenthesis follows, so a parameter may be called ``max``.
- A random function in an expression draws a new value for every element under ``.SAMPLING`` with ``useExpr=true``.
"""

from __future__ import annotations

import math

from resgrid.spice.dialects.record import ARCS, FUNCTIONS, SUFFIXES, Dialect, Quirks, ReadingRules, Statements, Words
from resgrid.spice.dialects.refusals import LTSPICE_COMMANDS, Refusals

_VARIABLES = {
    "time": "the time",
    "freq": "the frequency",
    "hertz": "the frequency",
    "vt": "the thermal voltage, by constants that differ between versions",
    "gmin": "the conductance that .options device sets",
    "onoise": "a result of .noise",
    "inoise": "a result of .noise",
    "poly": "a word of controlled sources",
}
_CONSTANTS = {"pi": math.pi, "ctok": 273.15, "constctok": 273.15}
_WORDS = Words(
    constants=_CONSTANTS,
    temperature=frozenset({"temp", "temper"}),
    variables=_VARIABLES,
    undefinable=frozenset({"temp", "temper", *_VARIABLES, *_CONSTANTS}),
)

_SWEEP = ".dc {source} {volts} {volts} 1.0"

XYCE = Dialect(
    name="xyce",
    label="Xyce",
    reserved=frozenset({"gnd"}),
    nonlinear_resistor="{name} {a} {b} i={{{current}*tanh(v({a},{b})/{voltage})}}",
    behavioural_current="{name} {a} {b} i={{{value}}}",
    parameters=" params: {values}",
    instance_parameters=" params:",
    precise=".options nonlin reltol=1e-12 abstol=1e-15",
    statements=Statements(
        first=("* Xyce {deck}.xyce",),
        one_a_run=True,
        charged=(".options timeint reltol={reltol} abstol={vntol}", ".tran {step} {stop} 0.0 {step} uic"),
        operating=(_SWEEP,),
        noise=(".noise v({node}) {source} dec {points} {start} {stop}", ".print noise format=csv onoise inoise"),
        temperature=(_SWEEP, ".step temp list {temperatures}"),
        mismatch=(_SWEEP, ".sampling useexpr=true", ".options samples numsamples={runs} seed={seed}"),
        probe=".print {kind} format=csv precision=16 {what}",
        print_all=".print {kind} format=csv precision=16 v(*)",
    ),
    quirks=Quirks(),
    reading=ReadingRules(
        name="xyce",
        signs=(
            b"\n.preprocess",
            b"\n.global_param",
            b"\n.sampling",
            b"\n.options device ",
            b"\n.options linsol",
            b"\n.options nonlin ",
            b"\n.options timeint ",
        ),
        suffixes={**SUFFIXES, "x": 6},
        grounds=frozenset({"0"}),
        no_grounds=frozenset({"gnd", "gnd!", "ground"}),
        functions={
            **FUNCTIONS,
            **ARCS,
            "if": "if",
            "limit": "limit",
            "nint": "nint",
            "stp": "step",
            "uramp": "ramp",
        },
        model_factor=True,
        off_ohms=1e6,
        words=_WORDS,
        refusals=Refusals(foreign_commands=LTSPICE_COMMANDS, blank_names="unsure", letters="unsure"),
    ),
)
