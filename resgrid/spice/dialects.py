"""What differs between circuit simulators, as data.

All of them read elements by the first letter, nodes by name, and numbers; everything else has its traps.  The names of
statements, and which character begins a comment or a parameter expression, are in the table below.

ngspice
-------
What its decks must respect, each learnt by experiment with ngspice 39, and tried with 46:

- The first line of a file it is given is a title, whatever it says; in an included file it is not.  A full-line
  comment in front serves both.  A line that begins with ``*#`` is a command, not a comment.
- ``1M`` is a milliohm and ``1F`` a femto-anything: numbers are written plain.  They are read digit by digit, so a
  number of 17 digits arrives with an error of up to 2 units in the last place.
- Case is folded, and ``gnd`` is another name of node ``0``.
- A node that floats, if only behind a capacitor, makes the matrix singular.  ngspice then steps gmin and supplies,
  ends in a pseudo-transient, and reports a wrong answer (every node is a little off) with exit status 0.
- 0 ohm silently becomes 1 milliohm; smaller but positive values are kept.  Version 46 says that it is 1e-12 ohm, and
  loses nine digits to it.
- A loop of voltage sources ends without an answer, a second device of the same name without a run.
- A linear operating point is solved directly: ``gmin``, ``reltol``, ``abstol``, ``vntol``, ``pivtol`` and ``pivrel``
  change nothing (agreement is 1e-14 on uniform grids, 1e-10 where conductances span ten decades), ``rshunt`` ruins it
  (1e-6), ``noopiter`` goes the way of the floating node.  So no option is set but ``klu``, the faster matrix package
  of newer versions, which older ones ignore; their own takes 0.4 s for 64 x 64 cells, 11 s for 128 x 128.
- Printed numbers are cut to ``numdgt`` digits: only the binary raw file holds the voltages as they are.
  ``SPICE_ASCIIRAWFILE`` in the environment and a ``.spiceinit`` in the home folder can change what is written.
- In batch mode with a control block it may exit with status 1 after a perfect run: neither status says anything.
- A control block may run any shell command: no deck from elsewhere is simulated with one.

LTspice
-------
- ``M`` is milli and ``Meg`` mega, as in SPICE; ``1F`` is a femto, and so is the ``F`` of a unit.
- Temperature coefficients are a list, ``tc=tc1, tc2`` (LTspice help, "R. Resistor"); of a blank before the second one
  ngspice in its compatibility mode is fond, too.
- Raw files hold voltages in single precision unless ``.options numdgt=15`` says otherwise.
- ``;`` begins a comment anywhere in a line, ``*`` at its start.
- ``gauss(sigma)`` and ``mc(value, tolerance)`` take new values for every element and step, but the same ones in every
  run unless its control panel says otherwise; there is no seed statement.

Xyce
----
- Expressions go in braces, subcircuit parameters behind ``PARAMS:``, in the definition and in every instance.
- Nothing is printed but what ``.PRINT`` asks for; an operating point is a ``.DC`` sweep of one step.
- ``gnd`` is a node like any other, unless ``.PREPROCESS REPLACEGROUND TRUE`` is there.
- A random function in an expression is a new draw for every element under ``.SAMPLING`` with ``useExpr=true``.

HSPICE
------
- ``$`` begins a comment anywhere; expressions go in single quotes; ``gnd``, ``gnd!`` and ``ground`` are node ``0``.
- The nominal temperature is 25 degrees Celsius, not 27: decks say ``.option tnom=27``, and ``.temp 27``.
- A behavioural current is a G element, ``cur='...'``; it has no B element.
- ``.end`` ends a simulation, and what follows is the next one: decks are included last.
- ``gauss(nominal, relative variation, sigma)`` and ``agauss`` draw anew wherever an element refers to them.

Spectre
-------
- Its own language: ``name (nodes) master parameter=value``, ``//`` comments, and a line ``simulator lang=spectre``.
- Case matters; ``M`` is mega and ``m`` milli, unlike in every SPICE; ``1meg`` is not a number.
- Subcircuit parameters stand in the body, behind ``parameters``; mismatch varies per subcircuit instance, so that
  every resistor becomes one.
- It has no end statement and no measurements of its own (those belong to MDL): decks hold analyses only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from resgrid.errors import InputError


@dataclass(frozen=True)
class Dialect:
    """How one simulator wants its decks.

    Templates are for `str.format`; their fields are ``name``, ``a`` and ``b`` (nodes), ``value``, and what is named.

    `name`: what the user calls it; `ground`: name of the reference node; `reserved`: legal words that mean something
    else as a node name; `comment`: what a full-line comment begins with; `preamble`: lines that every deck begins
    with, behind its title; `resistor, voltage_source, current_source, capacitor`: A line of each kind; values in SI
    units; `nonlinear_resistor`: the same for ``I = current * tanh(V / voltage)``; `behavioural_current`: A source of
    the current ``value``, an expression; `spread_resistor`: A resistor whose value the simulator draws: normal,
    ``sigma`` times the value its standard deviation; `spread_preamble`: what that needs in front, for ``sigma``;
    `temperature_coefficients`: what is added to a resistor's line, for ``tc1`` in 1/K and ``tc2`` in 1/K^2;
    `piecewise`: what is added to a source's line to make it move in time: ``points``, pairs of time and value;
    `small_signal`: what is added to the line of a source of 1 V in a small-signal analysis; `voltage`: the voltage
    between ``a`` and ``b`` in an expression; `expression`: how an expression ``value`` stands where a number would;
    `parameter`: definition of the parameter ``name``; `subcircuit, parameters, instance, end_subcircuit`: first line
    of a subcircuit (``name``, ``nodes``, ``defaults``), how its parameters are introduced (in the body or in that
    line, see `parameters_in_body`), an instance (``name``, ``nodes``, ``master``, ``values``), and the last line;
    `parameters_in_body`: whether the parameters of a subcircuit stand in a line of their own; `include`: the
    statement that includes ``file``; `precise`: the options that make Newton's method agree to 1e-9 where there are
    nonlinear resistors; `end`: last line of a deck; may be empty; `commands`: the second file, that includes the deck
    and asks for its operating point: ``deck``, and ``source``, the name of a voltage source, with its ``volts``.
    """

    name: str
    ground: str
    reserved: frozenset[str]
    comment: str
    preamble: tuple[str, ...]
    resistor: str
    voltage_source: str
    current_source: str
    capacitor: str
    nonlinear_resistor: str
    behavioural_current: str
    spread_resistor: str
    spread_preamble: tuple[str, ...]
    temperature_coefficients: str
    piecewise: str
    small_signal: str
    voltage: str
    expression: str
    parameter: str
    subcircuit: str
    parameters: str
    instance: str
    end_subcircuit: str
    parameters_in_body: bool
    include: str
    precise: str
    end: str
    commands: str


_SPECTRE_WORDS = frozenset(
    """
    gnd ground and correlate else end ends export for function global ic if inline library local march model
    nodeset or parameters paramset plot print protect pwr real return save section sens simulator statistics
    subckt to truncate unprotect vary info altergroup ahdl_include include
    """.split()  # noqa: SIM905
)
_NGSPICE = Dialect(
    name="ngspice",
    ground="0",
    reserved=frozenset({"gnd"}),
    comment="* ",
    preamble=(),
    resistor="{name} {a} {b} {value}",
    voltage_source="{name} {a} {b} {value}",
    current_source="{name} {a} {b} {value}",
    capacitor="{name} {a} {b} {value}",
    nonlinear_resistor="{name} {a} {b} i={current}*tanh(v({a},{b})/{voltage})",
    behavioural_current="{name} {a} {b} i={value}",
    spread_resistor="{name} {a} {b} {{gauss({value},{sigma},1)}}",
    spread_preamble=(),
    temperature_coefficients=" tc1={tc1} tc2={tc2}",
    piecewise=" pwl({points})",
    small_signal=" ac 1",
    voltage="v({a},{b})",
    expression="{{{value}}}",
    parameter=".param {name}={value}",
    subcircuit=".subckt {name} {nodes}{defaults}",
    parameters=" {values}",
    instance="{name} {nodes} {master}{values}",
    end_subcircuit=".ends",
    parameters_in_body=False,
    include='.include "{file}"',
    precise=".options reltol=1e-12 abstol=1e-18 vntol=1e-12",
    end=".end",
    commands=(
        "* operating point of {deck}\n"
        "* ngspice -n -b -r operating_point.raw {deck}.ngspice\n"
        '.include "{deck}"\n'
        ".options klu\n"
        ".op\n"
        ".end\n"
    ),
)
_LTSPICE = replace(
    _NGSPICE,
    name="ltspice",
    spread_resistor="{name} {a} {b} {{{value}*(1+gauss({sigma}))}}",
    temperature_coefficients=" tc={tc1}, {tc2}",
    parameters=" params: {values}",
    commands=(
        '* operating point of {deck}\n* LTspice -b {deck}.ltspice\n.options numdgt=15\n.op\n.include "{deck}"\n.end\n'
    ),
)
_XYCE = replace(
    _NGSPICE,
    name="xyce",
    nonlinear_resistor="{name} {a} {b} i={{{current}*tanh(v({a},{b})/{voltage})}}",
    behavioural_current="{name} {a} {b} i={{{value}}}",
    parameters=" params: {values}",
    precise=".options nonlin reltol=1e-12 abstol=1e-15",
    commands=(
        "* operating point of {deck}\n"
        "* Xyce {deck}.xyce\n"
        ".dc {source} {volts} {volts} 1.0\n"
        ".print dc format=csv precision=16 v(*)\n"
        '.include "{deck}"\n'
        ".end\n"
    ),
)
_HSPICE = replace(
    _NGSPICE,
    name="hspice",
    reserved=frozenset({"gnd", "ground"}),
    preamble=(".option tnom=27", ".temp 27"),
    nonlinear_resistor="g{name} {a} {b} cur='{current}*tanh(v({a},{b})/{voltage})'",
    behavioural_current="g{name} {a} {b} cur='{value}'",
    spread_resistor="{name} {a} {b} 'gauss({value},{sigma},1)'",
    expression="'{value}'",
    precise=".option reli=1e-12 absi=1e-18 absv=1e-12 relv=1e-12",
    commands=(
        "* operating point of {deck}\n"
        "* hspice {deck}.hspice\n"
        ".option post=1 numdgt=10 ingold=2\n"
        ".op\n"
        ".print dc v(*)\n"
        '.include "{deck}"\n'
        ".end\n"
    ),
)
_SPECTRE = Dialect(
    name="spectre",
    ground="0",
    reserved=_SPECTRE_WORDS,
    comment="// ",
    preamble=("simulator lang=spectre", "global 0"),
    resistor="{name} ({a} {b}) resistor r={value}",
    voltage_source="{name} ({a} {b}) vsource dc={value}",
    current_source="{name} ({a} {b}) isource dc={value}",
    capacitor="{name} ({a} {b}) capacitor c={value}",
    nonlinear_resistor="{name} ({a} {b}) bsource i={current}*tanh(v({a},{b})/{voltage})",
    behavioural_current="{name} ({a} {b}) bsource i={value}",
    spread_resistor="{name} ({a} {b}) spread_resistor r={value}",
    spread_preamble=(
        "parameters spread=1",
        "statistics {{",
        "  mismatch {{",
        "    vary spread dist=gauss std={sigma}",
        "  }}",
        "}}",
        "subckt spread_resistor (a b)",
        "parameters r=1{defaults}",
        "r_1 (a b) resistor r=r*spread{passed}",
        "ends",
    ),
    temperature_coefficients=" tc1={tc1} tc2={tc2}",
    piecewise=" type=pwl wave=[{points}]",
    small_signal=" mag=1",
    voltage="v({a},{b})",
    expression="{value}",
    parameter="parameters {name}={value}",
    subcircuit="subckt {name} ({nodes}){defaults}",
    parameters="parameters {values}",
    instance="{name} ({nodes}) {master}{values}",
    end_subcircuit="ends",
    parameters_in_body=True,
    include='include "{file}"',
    precise="precise options reltol=1e-12 vabstol=1e-12 iabstol=1e-18",
    end="",
    commands=(
        "// operating point of {deck}\n"
        "// spectre {deck}.spectre\n"
        "simulator lang=spectre\n"
        'include "{deck}"\n'
        "operating_point dc oppoint=rawfile\n"
    ),
)

DIALECTS = {dialect.name: dialect for dialect in (_NGSPICE, _LTSPICE, _XYCE, _HSPICE, _SPECTRE)}


def dialect_named(name: str) -> Dialect:
    """Look a dialect up."""
    if name not in DIALECTS:
        raise InputError(f"there is no SPICE dialect {name!r}; choose one of {', '.join(sorted(DIALECTS))}")
    return DIALECTS[name]
