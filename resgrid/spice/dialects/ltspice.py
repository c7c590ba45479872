"""Dialect of LTspice as data: rules of its decks, from its help; LTspice was not run.

- ``M`` is milli and ``Meg`` mega, as in SPICE; ``1F`` is 1e-15, so a unit ``F`` changes the value.
- Temperature coefficients are a list, ``tc=tc1, tc2`` (LTspice help, "R. Resistor"); with a blank before the second
  one ngspice in its compatibility mode reads the list, too.
- Raw files hold voltages in single precision unless ``.options numdgt=15`` is set.
- ``;`` begins a comment anywhere in a line, ``*`` at its start.
- ``gauss(sigma)`` and ``mc(value, tolerance)`` draw new values for every element and step, but the same ones in every
  run unless the control panel is set otherwise; there is no seed statement.
- ``pi`` is a constant and ``temp`` the simulation temperature (LTspice help, ".PARAM" and ".STEP", and its list of
  functions).  A deck that redefines one of them, or ``time``, is rejected, because the help does not define which value
  is used.
- Values after ``.param name=`` need no braces (LTspice help, ".PARAM": ``z=1k*tan(pi/4+.1)``).
"""

from __future__ import annotations

import math

from resgrid.spice.dialects.record import ARCS, FUNCTIONS, Dialect, Quirks, ReadingRules, Statements, Words
from resgrid.spice.dialects.refusals import Refusals

_WORDS = Words(
    functions=frozenset(
        """
        abs absdelay acos acosh arccos arccosh arcsin arcsinh arctan arctanh asin asinh atan atan2 atanh buf cbrt ceil
        cos cosh ddt delay exp fabs flat floor gauss hypot idt idtmod if int inv limit ln log log10 max mc min pow pwr
        pwrs rand random round sdt sgn sin sinh sqrt table tan tanh u uramp white
        """.split()  # noqa: SIM905
    ),
    constants={"pi": math.pi},
    temperature=frozenset({"temp"}),
    variables={"time": "the time", "freq": "the frequency"},
    undefinable=frozenset({"pi", "temp", "time"}),
    loose="any",
    true_above_half=True,
)

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
        charged=(
            ".options reltol={reltol} abstol={abstol} vntol={vntol} chgtol={chgtol} trtol=1",
            ".tran {step} {stop} 0.0 {step} uic",
        ),
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
            "if": "if_half",
            "limit": "limit",
            "round": "nint",
            "u": "step",
            "uramp": "ramp",
            "buf": "step_half",
        },
        infix_suffixes=True,
        annotations=frozenset({"tol", "pwr", "mfg", "pn", "type"}),
        flags=frozenset({"noiseless"}),
        series_resistance=True,
        inductor_ohms=1e-3,
        inductor_keys=frozenset({"rser", "ipk"}),
        capacitor_keys=frozenset({"rser", "v", "irms"}),
        words=_WORDS,
        refusals=Refusals(blank_names="unsure"),
    ),
)
