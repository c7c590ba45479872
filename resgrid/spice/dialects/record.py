"""Types of the data of a dialect: reserved names, rules for reading and writing decks, statements, quirks and costs.

The type `Dialect` joins the others.  The constants are the suffixes and functions that most dialects share.

Dialects of SPICE disagree in these points when they read a deck (the module of each dialect lists more):

- A suffix ``x`` is mega in HSPICE and Xyce and an ignored unit in ngspice and LTspice; ``a`` is atto in HSPICE only.
  ``M`` is milli in SPICE and mega in Spectre.  ``4k7`` is 4700 in LTspice and 4000 in ngspice, so it is rejected
  outside LTspice.
- ``;``, ``//`` and ``$`` (after a blank) begin a comment in ngspice, ``$`` in HSPICE, ``;`` in LTspice and Xyce.
- Ground is ``0``; ``gnd`` is another name of ground except in Xyce (unless ``.preprocess replaceground true``).
- ``^`` is a power in ngspice and exclusive or in LTspice and Xyce.  ``log`` is the natural logarithm, but
  Xyce's manuals differ between versions, so it is rejected there.  HSPICE's ``pow`` truncates its exponent.
- The ``r`` of a resistor's model is a resistance in ngspice and a factor in Xyce.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from resgrid.spice.dialects.refusals import Refusals

Basis = Literal["measured", "documented"]

GROUND_NAME = "0"
"""Name of the reference node in every simulator."""


SUFFIXES = {"t": 12, "g": 9, "meg": 6, "k": 3, "m": -3, "u": -6, "µ": -6, "μ": -6, "n": -9, "p": -12, "f": -15}
"""Exponent of ten of each suffix of a number, in lower case, as most dialects have them.

HSPICE and Xyce have further suffixes; ngspice has no Greek ``μ``; Spectre's suffixes are others.
"""

_NAMES = (
    "sqrt exp ln log10 abs int floor ceil min max pow pwr sgn atan2 hypot "
    "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
)
FUNCTIONS = {name: name for name in _NAMES.split()}
"""Functions that have the same name and meaning in most dialects; each name is mapped to itself.

A dialect that lacks a function, or reads it otherwise (such as HSPICE's ``pow``), has a changed copy of this table.
"""

ARCS = {"arctan": "atan", "arcsin": "asin", "arccos": "acos"}
"""Long names of the inverse trigonometric functions, mapped to their short names."""


@dataclass(frozen=True, eq=False)
class Words:
    """Reserved names and expression syntax of one dialect.

    Names are in lower case.

    Attributes
    ----------
    functions : frozenset of str
        Names that the simulator reads as functions, including those that resgrid cannot evaluate.  An expression that
        refers to a parameter of such a name is rejected.
    constants : mapping of str to float
        Values of the built-in constants by name.
    temperature : frozenset of str
        Names of the simulation temperature, in degrees Celsius.
    nominal : frozenset of str
        Names of the nominal temperature, in degrees Celsius.
    variables : mapping of str to str
        Meanings of the built-in variables for which resgrid has no value, by name.
    undefinable : frozenset of str
        Names that no parameter, argument or function may have.  Other reserved names may be defined, but expressions
        that refer to them are rejected.
    parameter : str
        Regular expression that a parameter's name must match.
    temperature_in_values : bool
        Whether the temperature is available only in the values of resistors, capacitors, inductors and models.
    cold : frozenset of str
        Functions and operators that are not available in an expression that contains the temperature.
    loose : {"", "tight", "numeric", "any"}
        Unquoted expressions that are read after ``name=``: ``""`` none; ``"tight"`` those without blanks outside
        parentheses; ``"numeric"`` also those with blanks, if they begin with a number and are the only definition of
        their line; ``"any"`` all text up to the next name.
    loose_functions : bool
        Whether the body of a function needs neither braces nor quotes.
    redefines_functions : bool
        Whether a function defined in the deck replaces a built-in one.
    ends_of_three : bool
        Whether ``min`` and ``max`` of three arguments ignore the second argument.
    exponential_coefficient : bool
        Whether ``tce=`` of a resistor multiplies its resistance by ``1.01**(tce (T - Tnom))``.
    model_aliases : mapping of str to str
        Usual name by alternative name, for the parameters of resistor models.
    inner_names : bool
        Whether an undefined name in the values of an ``X`` line is looked up in the subcircuit that the line calls.
    joins_brackets : bool
        Whether parentheses directly after a word belong to the name of a node.
    misread : mapping of str to frozenset of str
        Words that the simulator misreads if a node, model or subcircuit is called so; the keys are ``"node"``,
        ``"model"`` and ``"subcircuit"``.
    common_nodes : frozenset of str
        Nodes that all subcircuits share without ``.global``.
    true_above_half : bool
        Whether a condition is true if its value exceeds one half; if False, it is true if the value is not zero.
    drops_quotes : bool
        Whether double quotes are removed, so that expressions within are misread, except in instances of subcircuits.
    """

    functions: frozenset[str] = frozenset()
    constants: Mapping[str, float] = field(default_factory=dict)
    temperature: frozenset[str] = frozenset()
    nominal: frozenset[str] = frozenset()
    variables: Mapping[str, str] = field(default_factory=dict)
    undefinable: frozenset[str] = frozenset()
    parameter: str = r"[^\W\d]\w*"
    temperature_in_values: bool = False
    cold: frozenset[str] = frozenset()
    loose: Literal["", "tight", "numeric", "any"] = ""
    loose_functions: bool = False
    redefines_functions: bool = False
    ends_of_three: bool = False
    exponential_coefficient: bool = False
    model_aliases: Mapping[str, str] = field(default_factory=dict)
    inner_names: bool = False
    joins_brackets: bool = False
    misread: Mapping[str, frozenset[str]] = field(default_factory=dict)
    common_nodes: frozenset[str] = frozenset()
    true_above_half: bool = False
    drops_quotes: bool = False


@dataclass(frozen=True, eq=False)
class ReadingRules:
    """Rules for reading decks of one dialect.

    `name`: name of the dialect; `signs`: byte strings in lower case that occur only in decks of this dialect; `suffix`:
    file name suffix of the decks, empty if none is typical; `comments`: marks that begin a comment anywhere in a line;
    `dollar_comments`: whether ``$`` after a blank or a comma, or first in a line, begins a comment; `suffixes`: power
    of ten of each suffix of a number; `infix_suffixes`: whether ``4k7`` is 4700; `d_exponents`: whether ``1d3`` is
    1000; `milli_mil`: whether ``mil`` is milli in expressions and 25.4e-6 elsewhere; `grounds`: names of node 0, in
    lower case; `no_grounds`: names of ordinary nodes that are ground in other dialects; `powers`: operators that raise
    to a power; `functions`: names of functions in expressions, mapped to those of
    `resgrid.spice.read.expressions.FUNCTIONS`; `model_factor`: whether the ``r`` of a resistor model is a factor of the
    resistance instead of the resistance; `lengths_twice`: whether a model's ``narrow`` and ``short`` are subtracted at
    both ends of the width and of the length (False: it is not known where; models with them are rejected);
    `annotations`: keys of an element without effect on a simulation; `flags`: words without a value and without effect;
    `operators`: operators that the simulator evaluates differently from resgrid, with the meaning in the simulator;
    `narrow_parser`: whether signs after operators and nested conditionals are misread; `puts_in_text`: whether
    functions and the values of an ``X`` line are substituted as text, so that their names are looked up where the text
    is inserted; `replaces_multipliers`: whether ``m=`` of an ``X`` line replaces ``m=`` in the subcircuit and does not
    apply to switches; `end_is_comment`: whether lines after ``.end`` are read; `first_counts`: whether the first of
    several models of one name is used, and the first of several values of one option on a line, instead of the last
    ones; `temp_command_first`: whether ``.temp`` overrides ``.option temp`` regardless of their order;
    `braced_temperatures`: whether a temperature must be a number or an expression in braces; `sheet_first`: whether a
    model's ``rsh`` overrides ``r``, even without length and width; `models_first`: whether a model's name is ignored
    after a value that does not begin with a digit; `parameters_first`: whether a parameter replaces the name of a model
    or subcircuit; `outer_parameters_win`: whether a parameter of a subcircuit has the value of the highest level that
    defines one of its name; `ignored_model_keys`: parameters of resistor models that only other dialects apply, with
    the replacement to suggest (empty: this dialect applies the parameter, but resgrid does not); `spaced_lists`:
    whether the values of ``tc=`` are separated by blanks, without parentheses; `scale_key`: whether ``scale=`` of a
    resistor multiplies its resistance; `refused_options`: options that change the circuit in a way that resgrid does
    not model; `refused_elements`: meaning of each first letter that means a different element than in SPICE;
    `series_resistance`: whether voltage sources may have ``rser=``; `inductor_ohms`: series resistance of an inductor
    without ``rser=0``, in ohms; `inductor_keys, capacitor_keys`: keys of series resistances and parasitics of an
    inductor and a capacitor; `off_ohms`: resistance of an open switch without ``roff``, in ohms; `holds_initial`:
    whether ``.ic`` fixes voltages at the operating point; `instances`: whether elements are instances of a master and
    names are case-sensitive, as in Spectre; `spice`: rules after ``simulator lang=spice`` in such a deck, None for
    other dialects; `quoted_expressions`: whether expressions are usually written in quotes instead of braces; `words`:
    reserved names and expression syntax; `refusals`: text that stops the simulator.
    """

    name: str
    signs: tuple[bytes, ...] = ()
    suffix: str = ""
    comments: tuple[str, ...] = (";",)
    dollar_comments: bool = False
    suffixes: Mapping[str, int] = field(default_factory=lambda: SUFFIXES)
    grounds: frozenset[str] = frozenset({"0", "gnd"})
    no_grounds: frozenset[str] = frozenset()
    functions: Mapping[str, str] = field(default_factory=lambda: FUNCTIONS)
    infix_suffixes: bool = False
    d_exponents: bool = False
    milli_mil: bool = False
    powers: frozenset[str] = frozenset({"**"})
    model_factor: bool = False
    lengths_twice: bool = False
    annotations: frozenset[str] = frozenset()
    flags: frozenset[str] = frozenset()
    operators: Mapping[str, str] = field(default_factory=dict)
    narrow_parser: bool = False
    puts_in_text: bool = False
    replaces_multipliers: bool = False
    end_is_comment: bool = False
    first_counts: bool = False
    temp_command_first: bool = False
    braced_temperatures: bool = False
    sheet_first: bool = False
    models_first: bool = False
    parameters_first: bool = False
    outer_parameters_win: bool = False
    ignored_model_keys: Mapping[str, str] = field(default_factory=dict)
    spaced_lists: bool = False
    scale_key: bool = False
    refused_options: frozenset[str] = frozenset()
    refused_elements: Mapping[str, str] = field(default_factory=dict)
    series_resistance: bool = False
    inductor_ohms: float = 0.0
    inductor_keys: frozenset[str] = frozenset()
    capacitor_keys: frozenset[str] = frozenset()
    off_ohms: float = 1e12
    holds_initial: bool = False
    instances: bool = False
    spice: ReadingRules | None = None
    quoted_expressions: bool = False
    words: Words = field(default_factory=Words)
    refusals: Refusals = field(default_factory=Refusals)


@dataclass(frozen=True)
class Statements:
    """Statements of a simulator that request analyses; templates for `str.format`, one line each.

    The fields of a template are the attributes of the analysis (a class of `resgrid.spice.analyses`), such as ``stop``
    in seconds, and ``deck`` (file name of the deck), ``results`` (name of the result file), ``source`` (a voltage
    source of the deck, for analyses that need one) and ``volts`` (voltage of ``source``).

    `first, last`: first and last lines of the file; `deck_first`: whether the deck is included before the statements;
    `charged`: a transient that begins with the given voltages of capacitors, without an operating point, with the
    relative tolerance ``reltol``, and the absolute ones ``abstol`` (amperes), ``vntol`` (volts) and ``chgtol``
    (coulombs); `operating, transient, noise, temperature, mismatch`: the analyses, where ``temperatures`` and
    ``numbers`` (of the runs) are lists separated by blanks; `run`: lines that start the other analyses if one analysis
    is a control block; `one_a_run`: whether a file may hold one analysis only; `print_all`: statement that prints all
    voltages, with the word for the analysis (such as ``tran``) as ``kind``; empty if the simulator saves all voltages
    by default; `probe`: statement that saves the quantities in the field ``what``; `probe_voltage, probe_current`: the
    voltage of the node ``name`` and the current of the source ``name`` in the statement `probe`; `maximum, minimum,
    value, crossing`: statements that measure, in a transient, the largest and smallest voltage of ``node``, its voltage
    at the time ``at``, and the time at which it first crosses the voltage ``at``; `measure_first, measure_last`: lines
    around the measurements.
    """

    first: tuple[str, ...]
    temperature: tuple[str, ...]
    mismatch: tuple[str, ...]
    probe: str
    operating: tuple[str, ...] = (".op",)
    transient: tuple[str, ...] = (".tran {step} {stop} 0.0 {step}",)
    charged: tuple[str, ...] = (
        ".options reltol={reltol} abstol={abstol} vntol={vntol}",
        ".tran {step} {stop} 0.0 {step} uic",
    )
    noise: tuple[str, ...] = (".noise v({node}) {source} dec {points} {start} {stop}",)
    last: tuple[str, ...] = (".end",)
    deck_first: bool = False
    run: tuple[str, ...] = ()
    one_a_run: bool = False
    print_all: str = ""
    probe_voltage: str = "v({name})"
    probe_current: str = "i({name})"
    maximum: str = ".measure tran {name} max v({node})"
    minimum: str = ".measure tran {name} min v({node})"
    value: str = ".measure tran {name} find v({node}) at={at}"
    crossing: str = ".measure tran {name} when v({node})={at} cross=1"
    measure_first: tuple[str, ...] = ()
    measure_last: tuple[str, ...] = ()


@dataclass(frozen=True)
class Quirks:
    """Behaviour of a simulator for circuits that violate electrical rules.

    `basis`: whether the behaviour was measured or taken from the manual; `smallest_resistance`: value in ohms to which
    smaller resistances are raised, 0 ohm included; None if it is not known; `raises_zero_only`: whether only 0 ohm is
    raised to this value, and smaller positive resistances are kept; `floating`: nodes that receive a conductance `gmin`
    to ground if any node floats: all nodes ("everywhere"), the floating nodes ("there"), or "unknown"; `gmin`: default
    value of this conductance, in siemens; `gmin_options`: options that set `gmin`, by decreasing precedence;
    `shunt_options`: unit ("ohms" or "siemens") of each option that adds a resistor from every node to ground;
    `duplicates`: effect of a second element of one name: end of the run ("fails") or "unknown"; `loops`: whether all
    loops of voltage sources end the run ("fail"), or only loops tied to ground ("fail at ground"); other loops, and
    loops of inductors, are solved by a transient.
    """

    basis: Basis = "documented"
    smallest_resistance: float | None = None
    raises_zero_only: bool = False
    floating: Literal["everywhere", "there", "unknown"] = "unknown"
    gmin: float = 1e-12
    gmin_options: tuple[str, ...] = ("gmin",)
    shunt_options: Mapping[str, Literal["ohms", "siemens"]] = field(default_factory=dict)
    duplicates: Literal["fails", "unknown"] = "unknown"
    loops: Literal["fail", "fail at ground"] = "fail"


@dataclass(frozen=True)
class Costs:
    """Cost model of one engine for an operating point, in seconds on one core of 2020s server hardware and in bytes.

    The time is ``start + element * elements + core * width**width_power * size**size_power`` and the memory
    ``start_bytes + element_bytes * elements + fill_bytes * size * width``.  `elements` is the number of elements;
    `size` is the number of nodes with more than two neighbours in the core of the network, which is the network without
    nodes of known voltage and without dangling trees; `width` is the number of core nodes per breadth-first level.
    """

    start: float
    element: float
    core: float
    width_power: float
    size_power: float
    start_bytes: float
    element_bytes: float
    fill_bytes: float = 50.0


@dataclass(frozen=True)
class Dialect:
    """One simulator: templates of its statements, its reading rules, its quirks and its engines.

    Templates are for `str.format`.  Their fields are ``name``, ``a`` and ``b`` (nodes), ``value``, and those named
    below.  The voltage of an element counts from ``a`` to ``b``; its current flows from ``a`` through it to ``b``.

    `name`: name in options and arguments; `label`: name in messages; `reserved`: legal words with a special meaning as
    a node name; `comment`: beginning of a full-line comment; `preamble`: lines after the title of every deck;
    `resistor, voltage_source, current_source, capacitor`: line of an element, values in SI units; `nonlinear_resistor`:
    line of an element with ``I = current * tanh(V / voltage)`` (fields ``current``, ``voltage``);
    `behavioural_current`: line of a current source whose ``value`` is an expression; `spread_resistor`: line of a
    resistor with a normally distributed value, drawn by the simulator, of standard deviation ``sigma * value``;
    `spread_preamble`: lines that `spread_resistor` needs, with ``sigma`` and texts for temperature coefficients
    (``defaults``, ``passed``), which may be empty; `temperature_coefficients`: end of a resistor's line, for ``tc1`` in
    1/K and ``tc2`` in 1/K^2; `piecewise`: end of a source's line for a piecewise linear waveform with ``points``, pairs
    of time and value; `small_signal`: end of a voltage source's line that gives it an amplitude of 1 V in a
    small-signal analysis; `initial_voltage`: end of a capacitor's line for its voltage at time 0, in a transient that
    begins with such voltages; `expression`: an expression ``value`` in place of a number; `parameter`: definition of
    the global parameter ``name``; `subcircuit`: first line of a subcircuit (``name``, ``nodes``, ``defaults``);
    `parameters`: definition of a subcircuit's parameters, in a line of their own if `parameters_in_body`, else in the
    first line; `instance`: an instance (``name``, ``nodes``, ``master``, ``values``); `instance_parameters`: word
    before the values of an instance; `end_subcircuit`: last line of a subcircuit; `include`: statement that includes
    ``file``; `precise`: options with which Newton's method converges to 1e-9 in circuits with nonlinear resistors;
    `end`: last line of a deck, may be empty; `statements`: statements of the second file, which includes the deck and
    requests analyses; `quirks`: behaviour for defective circuits; `nominal_temperature`: default temperature of element
    values, in degrees Celsius; `engines`: programs that can run the decks, with their costs; `checks_itself`: whether a
    self-check deck is written, with which the simulator itself compares its results with expected ones; `reading`:
    rules for reading decks of the dialect.
    """

    name: str
    label: str
    reserved: frozenset[str]
    statements: Statements
    quirks: Quirks
    reading: ReadingRules
    comment: str = "* "
    preamble: tuple[str, ...] = ()
    resistor: str = "{name} {a} {b} {value}"
    voltage_source: str = "{name} {a} {b} {value}"
    current_source: str = "{name} {a} {b} {value}"
    capacitor: str = "{name} {a} {b} {value}"
    nonlinear_resistor: str = "{name} {a} {b} i={current}*tanh(v({a},{b})/{voltage})"
    behavioural_current: str = "{name} {a} {b} i={value}"
    spread_resistor: str = "{name} {a} {b} {{gauss({value},{sigma},1)}}"
    spread_preamble: tuple[str, ...] = ()
    temperature_coefficients: str = " tc1={tc1} tc2={tc2}"
    piecewise: str = " pwl({points})"
    small_signal: str = " ac 1"
    initial_voltage: str = " ic={value}"
    expression: str = "{{{value}}}"
    parameter: str = ".param {name}={value}"
    subcircuit: str = ".subckt {name} {nodes}{defaults}"
    parameters: str = " {values}"
    instance: str = "{name} {nodes} {master}{values}"
    instance_parameters: str = ""
    end_subcircuit: str = ".ends"
    parameters_in_body: bool = False
    include: str = '.include "{file}"'
    precise: str = ".options reltol=1e-12 abstol=1e-18 vntol=1e-12"
    end: str = ".end"
    nominal_temperature: float = 27.0
    engines: Mapping[str, Costs] = field(default_factory=dict)
    checks_itself: bool = False
