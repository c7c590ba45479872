"""LTspice, told from its help.

- ``M`` is milli and ``Meg`` mega, as in SPICE; ``1F`` is a femto, and so is the ``F`` of a unit.
- Temperature coefficients are a list, ``tc=tc1, tc2`` (LTspice help, "R. Resistor"); of a blank before the second one
  ngspice in its compatibility mode is fond, too.
- Raw files hold voltages in single precision unless ``.options numdgt=15`` says otherwise.
- ``;`` begins a comment anywhere in a line, ``*`` at its start.
- ``gauss(sigma)`` and ``mc(value, tolerance)`` take new values for every element and step, but the same ones in every
  run unless its control panel says otherwise; there is no seed statement.
"""

from __future__ import annotations

from resgrid.spice.dialects.record import ARCS, FUNCTIONS, Dialect, Quirks, ReadingRules, Statements

LTSPICE = Dialect(
    name="ltspice",
    label="LTspice",
    reserved=frozenset({"gnd"}),
    spread_resistor="{name} {a} {b} {{{value}*(1+gauss({sigma}))}}",
    temperature_coefficients=" tc={tc1}, {tc2}",
    parameters=" params: {values}",
    instance_parameters=" params:",
    statements=Statements(
        first=("* LTspice -b {deck}.ltspice", ".options numdgt=15"),
        one_a_run=True,
        temperature=(".op", ".step temp list {temperatures}"),
        mismatch=(".op", ".step param run 1 {runs} 1"),
        probe=".save {what}",
    ),
    quirks=Quirks(shunt_options={"gshunt": "siemens"}, duplicates="fails"),
    reading=ReadingRules(
        name="ltspice",
        signs=(b"\n.backanno", b"ltspice"),
        functions={
            **FUNCTIONS,
            **ARCS,
            "log": "ln",
            "if": "if",
            "limit": "limit",
            "round": "nint",
            "u": "step",
            "uramp": "ramp",
            "buf": "step_half",
        },
        infix_suffixes=True,
        annotations=frozenset({"tol", "pwr", "mfg", "pn", "type"}),
        series_resistance=True,
        inductor_ohms=1e-3,
    ),
)
