"""What is known of a circuit simulator, as one record: how decks are read and written, and where it errs.

What dialects of SPICE disagree about when they read, and what follows (more traps stand on the simulators' pages):

- A suffix ``x`` is mega in HSPICE and Xyce and an ignored unit in ngspice and LTspice; ``a`` is atto in HSPICE alone.
  ``M`` is milli in all of them, but mega in Spectre.  ``4k7`` is 4700 in LTspice and 4000 in ngspice, so it is refused
  outside LTspice.
- ``;``, ``//`` and ``$`` (after a blank) end a line of ngspice; HSPICE knows ``$`` alone, LTspice and Xyce ``;``.
- Ground is ``0``; ``gnd`` is another name of it except in Xyce (unless ``.preprocess replaceground true``).
- ``^`` is a power in ngspice and exclusive or in LTspice and Xyce.  ``log`` is the natural logarithm, but
  Xyce's manuals differ between versions, so there it is refused.  HSPICE's ``pow`` cuts its exponent to an integer.
- The ``r`` of a resistor's model is a resistance in ngspice and a factor in Xyce.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Basis = Literal["measured", "documented"]

GROUND_NAME = "0"
"""What every simulator calls the reference node."""


SUFFIXES = {"t": 12, "g": 9, "meg": 6, "k": 3, "m": -3, "u": -6, "µ": -6, "μ": -6, "n": -9, "p": -12, "f": -15}
"""Powers of ten of the suffixes that all but Spectre know, in lower case."""

_NAMES = (
    "sqrt exp ln log10 abs int floor ceil min max pow pwr sgn atan2 hypot "
    "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
)
FUNCTIONS = {name: name for name in _NAMES.split()}
"""Functions that mean the same everywhere."""

ARCS = {"arctan": "atan", "arcsin": "asin", "arccos": "acos"}


@dataclass(frozen=True, eq=False)
class Words:
    """Reserved names of one dialect, and how expressions are written in it.

    Names are in lower case.

    Attributes
    ----------
    functions : frozenset of str
        Names that the simulator reads as functions, whether or not they are evaluated here.  A parameter of such a name
        is rejected where an expression refers to it.
    constants : mapping of str to float
        Built-in constants.
    temperature : frozenset of str
        Names of the simulation temperature, in degrees Celsius.
    nominal : frozenset of str
        Names of the nominal temperature, in degrees Celsius.
    variables : mapping of str to str
        Built-in variables that have no value here, and what they are.
    undefinable : frozenset of str
        Names that no parameter, argument or function may have.  Other reserved names are rejected where they are used.
    parameter : str
        Regular expression for the name of a parameter.
    temperature_in_values : bool
        Whether the temperature is known in the values of resistors, capacitors, inductors and models only.
    cold : frozenset of str
        Functions and operators that the simulator does not have in an expression of the temperature.
    loose : {"", "tight", "numeric", "any"}
        Unquoted expressions behind ``name=``: not read, read without blanks outside parentheses, also read with blanks
        if the card has one definition that begins with a number, read up to the next name.
    loose_functions : bool
        Whether the body of a function needs neither braces nor quotes.
    redefines_functions : bool
        Whether a function of the deck takes the place of a built-in one.
    ends_of_three : bool
        Whether ``min`` and ``max`` of three arguments compare the first and the last.
    exponential_coefficient : bool
        Whether ``tce=`` of a resistor multiplies by ``1.01**(tce (T - Tnom))``.
    model_aliases : mapping of str to str
        Further names for parameters of resistors' models.
    inner_names : bool
        Whether a name in the values of an ``X`` line that is unknown there is looked up in the subcircuit.
    joins_brackets : bool
        Whether parentheses directly behind a word belong to the name of a node.
    misread : mapping of str to frozenset of str
        Names that the simulator misreads as those of a ``"node"``, a ``"model"`` or a ``"subcircuit"``.
    common_nodes : frozenset of str
        Nodes that all subcircuits share without ``.global``.
    true_above_half : bool
        Whether conditions are true above one half, and not wherever they differ from zero.
    drops_quotes : bool
        Whether double quotes are dropped, so that an expression within them is misread, except in calls and first lines
        of subcircuits.
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
class Refusals:
    """Text that is read here, but stops the simulator, which then gives no answer, or of which that is not known.

    Attributes
    ----------
    commands : frozenset of str
        Commands that end the run.
    foreign_commands : frozenset of str
        Commands that the manual does not have.
    blank_names : {"", "fails", "unsure"}
        Consequence of a blank in a quoted name.
    letters : {"", "unsure"}
        Consequence of letters beyond ASCII.
    encodings : frozenset of str
        Encodings of files that end the run: ``"latin-1"``, ``"utf-16"``, ``"cr"`` (carriage returns between lines).
    commas : bool
        Whether a comma directly behind a value, in front of the next name, leaves no answer.
    idle_parameters : bool
        Whether a parameter without a value ends the run even if nothing refers to it.
    redefinitions : bool
        Whether the run may end where a parameter is defined twice.
    keys : mapping of str to frozenset of str
        Keys at which the run ends, by the letter of the element that has them.
    commands_in_comments : bytes
        Regular expression of comments that are commands, which are not run here; empty without such comments.
    """

    commands: frozenset[str] = frozenset()
    foreign_commands: frozenset[str] = frozenset()
    blank_names: Literal["", "fails", "unsure"] = ""
    letters: Literal["", "unsure"] = ""
    encodings: frozenset[str] = frozenset()
    commas: bool = False
    idle_parameters: bool = False
    redefinitions: bool = False
    keys: Mapping[str, frozenset[str]] = field(default_factory=dict)
    commands_in_comments: bytes = b""


LTSPICE_COMMANDS = frozenset({".backanno", ".loadbias", ".machine", ".savebias", ".wave"})
"""Commands of LTspice alone."""


@dataclass(frozen=True, eq=False)
class ReadingRules:
    """How decks of one dialect are read.

    `name`: the dialect; `signs`: what only its decks hold, in lower case, and `suffix`: what their names end in;
    `comments`: marks that end a line wherever they stand; `dollar_comments`: whether ``$`` after a blank or a
    comma, or first in a line, ends it too; `suffixes`: power of ten of a suffix; `infix_suffixes`: whether ``4k7``
    is 4700; `d_exponents`: whether ``1d3`` is 1000; `milli_mil`: whether ``mil`` is milli in expressions, 25.4e-6
    elsewhere; `grounds`: names of node 0, in lower case; `no_grounds`: names that are ground elsewhere; `powers`:
    operators that raise to a power; `functions`: what functions in expressions are called and which of
    `resgrid.spice.read.expressions.FUNCTIONS` they are; `model_factor`: whether the ``r`` of a resistor's model
    multiplies; `lengths_twice`: whether a model's ``narrow`` and ``short`` are taken off at both ends;
    `annotations`: what may be written behind an element without meaning anything to a simulation; `flags`: words of
    that kind; `operators`: operators that are not what `resgrid.spice.read.expressions` takes their symbols for;
    `narrow_parser`: whether signs after operators and choices within choices are misread; `puts_in_text`: whether
    functions, and what an ``X`` line gives, are put in as text: their names are looked up where they land;
    `replaces_multipliers`: whether ``m=`` of an ``X`` line takes the place of ``m=`` within, and does not reach
    switches; `end_is_comment`: whether what stands after ``.end`` is read; `first_counts`: whether the first of
    several models of one name counts, and the first of several options on a line; `temp_command_first`: whether
    ``.temp`` counts before ``.option temp``, wherever they stand; `braced_temperatures`: whether a temperature must
    be a number, or stand in braces; `sheet_first`: whether a model's ``rsh`` counts before its ``r``, even without
    length and width; `models_first`: whether a model's name is overlooked after a value that does not begin with a
    digit; `ignored_model_keys`: parameters of resistors' models that others obey, and what to write instead
    (nothing: they are obeyed, and not read here); `spaced_lists`: whether the values of ``tc=`` are parted by
    blanks, without parentheses; `scale_key`: whether ``scale=`` of a resistor is obeyed; `refused_options`: options
    that change the circuit in a way that is not followed here; `refused_elements`: what else a letter means;
    `series_resistance`: whether voltage sources may have ``rser=``; `inductor_ohms`: what an inductor has unless it
    says ``rser=0``; `inductor_keys, capacitor_keys`: series resistances and parasitics that an inductor and a
    capacitor may have; `off_ohms`: resistance of a switch that is off; `holds_initial`: whether ``.ic`` holds nodes
    at the operating point; `instances`: whether elements are instances of a master, as in Spectre, whose names and
    suffixes differ by case, too; `spice`: how such a deck is read behind ``simulator lang=spice``; `words`:
    reserved names and how expressions are written; `refusals`: text that stops the simulator itself.
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
    words: Words = field(default_factory=Words)
    refusals: Refusals = field(default_factory=Refusals)


@dataclass(frozen=True)
class Statements:
    """How a simulator is asked for analyses; templates for `str.format`, a line each.

    Fields are those of `resgrid.spice.analyses`, and ``deck``, ``results`` (the name of a file), ``source`` (a voltage
    source of the deck, for analyses that need one) and its ``volts``.

    `first, last`: lines in front of all others, and behind them; `deck_first`: whether the deck is included before
    the statements, not after them; `operating, transient, noise, temperature, mismatch`: the analyses;
    ``temperatures`` is a list with blanks, and so is ``numbers``, of the runs; `run`: what starts the other analyses
    where one of them is a control block; `one_a_run`: whether the simulator runs one analysis only; `print_all`: what
    must be there for anything to be printed; ``kind`` is the analysis; `probe, probe_voltage, probe_current`: what is
    kept, a statement with ``what``, and how a voltage and a current stand in it; `maximum, minimum, value, crossing`:
    the measurements, by `Measure.what`; `measure_first, measure_last`: lines around the measurements.
    """

    first: tuple[str, ...]
    temperature: tuple[str, ...]
    mismatch: tuple[str, ...]
    probe: str
    operating: tuple[str, ...] = (".op",)
    transient: tuple[str, ...] = (".tran {step} {stop} 0.0 {step}",)
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
    """What a simulator makes of circuits that are not quite sound; what is not known is not claimed.

    `basis`: whether the simulator was asked, or its manual; `smallest_resistance`: in ohms: what smaller resistances
    are raised to, 0 included; None where that is not known; `raises_zero_only`: positive values are kept; `floating`:
    where a conductance is added when a part floats: at every node, at the floating nodes, or nobody knows; `gmin`:
    that conductance, in siemens; `gmin_options`: options that change it, those that count before others first;
    `shunt_options`: options that tie every node to ground; `duplicates`: what a second element of the same name leads
    to; `loops`: which loops of voltage sources leave no answer; other loops, and those of inductors, leave it to a
    transient.
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
    """What one engine takes for an operating point; seconds on one core of 2020s server hardware.

    `start`: seconds before it begins; `element`: seconds an element; `core`: seconds for a core of one node, one
    wide; `width_power, size_power`: powers of the core's width and of its size; `start_bytes, element_bytes,
    fill_bytes`: memory at its start, an element, and an entry of ``size * width``.
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
    """One simulator.

    Templates are for `str.format`; their fields are ``name``, ``a`` and ``b`` (nodes), ``value``, and what is named.

    `name`: what the user calls it; `label`: what it calls itself; `reserved`: legal words that mean something else as a
    node name; `comment`: what a full-line comment begins with; `preamble`: lines that every deck begins with, behind
    its title; `resistor, voltage_source, current_source, capacitor`: a line of each kind; values in SI units;
    `nonlinear_resistor`: the same for ``I = current * tanh(V / voltage)``; `behavioural_current`: a source of the
    current ``value``, an expression; `spread_resistor`: a resistor whose value the simulator draws: normal, ``sigma``
    times the value its standard deviation; `spread_preamble`: what that needs in front, for ``sigma``;
    `temperature_coefficients`: what is added to a resistor's line, for ``tc1`` in 1/K and ``tc2`` in 1/K^2;
    `piecewise`: what is added to a source's line to make it move in time: ``points``, pairs of time and value;
    `small_signal`: what is added to the line of a source of 1 V in a small-signal analysis; `expression`: how an
    expression ``value`` stands where a number would; `parameter`: definition of the parameter ``name``; `subcircuit,
    parameters, instance, end_subcircuit`: first line of a subcircuit (``name``, ``nodes``, ``defaults``), how its
    parameters are introduced (in the body or in that line, see `parameters_in_body`), an instance (``name``, ``nodes``,
    ``master``, ``values``), and the last line; `instance_parameters`: what stands in front of an instance's values;
    `parameters_in_body`: whether the parameters of a subcircuit stand in a line of their own; `include`: the statement
    that includes ``file``; `precise`: the options that make Newton's method agree to 1e-9 where there are nonlinear
    resistors; `end`: last line of a deck; may be empty; `statements`: the second file, that includes the deck and asks
    for analyses; `quirks`: where it errs; `nominal_temperature`: at which values hold unless a deck says otherwise, in
    degrees Celsius; `engines`: programs that run its decks here, and what they cost; `checks_itself`: whether its decks
    have a companion; `reading`: how its decks are read.
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
