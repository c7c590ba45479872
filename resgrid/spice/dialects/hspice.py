"""Dialect of HSPICE as data: rules of its decks, from its reference manuals; HSPICE was not run.

- ``$`` begins a comment anywhere; expressions are written in single quotes; ``gnd``, ``gnd!`` and ``ground`` are node
  ``0``.
- The nominal temperature is 25 degrees Celsius, not 27: decks set ``.option tnom=27`` and ``.temp 27``.
- A behavioural current source is a G element, ``cur='...'``; HSPICE has no B element.
- ``.end`` ends a simulation, and the lines after it begin the next one: the file of commands includes the deck last.
- ``gauss(nominal, relative variation, sigma)`` and ``agauss`` draw a new value for every element that refers to them.
- ``time``, ``temper`` and ``hertz`` are variables of the simulator (HSPICE Simulation and Analysis User Guide, "HSPICE
  special variables"); a deck that redefines one is rejected, and so is a function of a built-in name.  An expression
  with blanks is written in quotes.
- Smaller resistances are raised to ``RESMIN`` (1e-5 ohm); ``gmin``, a conductance to ground, is added at the
  floating nodes only, with a message.
"""

from __future__ import annotations

from resgrid.spice.dialects.record import FUNCTIONS, SUFFIXES, Dialect, Quirks, ReadingRules, Statements, Words
from resgrid.spice.dialects.refusals import LTSPICE_COMMANDS, Refusals

_WORDS = Words(
    functions=frozenset(
        """
        abs acos acosh agauss asin asinh atan atanh aunif ceil cos cosh db exp floor gauss int limit ln log log10 max
        min nint pow pwr sgn sign sin sinh sqrt tan tanh unif
        """.split()  # noqa: SIM905
    ),
    temperature=frozenset({"temper"}),
    variables={"time": "the time", "hertz": "the frequency"},
    undefinable=frozenset({"time", "temper", "hertz"}),
    loose="tight",
)

HSPICE = Dialect(
    name="hspice",
    label="HSPICE",
    reserved=frozenset({"gnd", "ground"}),
    preamble=(".option tnom=27", ".temp 27"),
    nominal_temperature=25.0,
    nonlinear_resistor="g{name} {a} {b} cur='{current}*tanh(v({a},{b})/{voltage})'",
    behavioural_current="g{name} {a} {b} cur='{value}'",
    spread_resistor="{name} {a} {b} 'gauss({value},{sigma},1)'",
    expression="'{value}'",
    precise=".option reli=1e-12 absi=1e-18 absv=1e-12 relv=1e-12",
    statements=Statements(
        first=("* hspice {deck}.hspice", ".option post=1 numdgt=10 ingold=2"),
        operating=(".op", ".print dc v(*)"),
        transient=(".option delmax={step}", ".tran {step} {stop}"),
        charged=(
            ".option relv={reltol} absv={vntol} reli={reltol} absi={abstol} delmax={step}",
            ".tran {step} {stop} uic",
        ),
        noise=(".ac dec {points} {start} {stop}", ".noise v({node}) {source} {points}", ".print noise onoise"),
        temperature=(".dc temp poi {count} {temperatures}",),
        mismatch=(".option seed={seed}", ".dc monte={runs}"),
        probe=".probe {kind} {what}",
    ),
    quirks=Quirks(
        smallest_resistance=1e-5,
        floating="there",
        shunt_options={"gshunt": "siemens"},
    ),
    reading=ReadingRules(
        name="hspice",
        signs=(b"\n.option post", b"\n.options post", b"\n.option parhier"),
        comments=(),
        dollar_comments=True,
        suffixes={**SUFFIXES, "x": 6, "a": -18},
        grounds=frozenset({"0", "gnd", "gnd!", "ground"}),
        functions={**FUNCTIONS, "log": "ln", "nint": "nint", "pow": "pow_integer", "pwr": "pwr_signed"},
        d_exponents=True,
        lengths_twice=True,
        refused_elements={"s": "an S element, which HSPICE reads as scattering parameters"},
        holds_initial=True,
        quoted_expressions=True,
        outer_parameters_win=True,
        inductor_keys=frozenset({"r"}),
        words=_WORDS,
        refusals=Refusals(foreign_commands=LTSPICE_COMMANDS | {".step"}, blank_names="unsure", letters="unsure"),
    ),
)
