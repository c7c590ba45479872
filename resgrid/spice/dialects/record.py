"""What is known of a circuit simulator, as one record: how it is written for, asked for analyses, and where it errs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from resgrid.spice.dialects.reading import ReadingRules

Basis = Literal["measured", "documented"]


@dataclass(frozen=True)
class Statements:
    """How a simulator is asked for analyses; templates for `str.format`, a line each.

    Fields are those of `resgrid.spice.analyses`, and ``deck``, ``source`` (a voltage source of the deck, for analyses
    that need one) and its ``volts``.

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

    `name`: what the user calls it; `label`: what it calls itself; `ground`: name of the reference node; `reserved`:
    legal words that mean something else as a node name; `comment`: what a full-line comment begins with; `preamble`:
    lines that every deck begins with, behind its title; `resistor, voltage_source, current_source, capacitor`: a line
    of each kind; values in SI units; `nonlinear_resistor`: the same for ``I = current * tanh(V / voltage)``;
    `behavioural_current`: a source of the current ``value``, an expression; `spread_resistor`: a resistor whose value
    the simulator draws: normal, ``sigma`` times the value its standard deviation; `spread_preamble`: what that needs
    in front, for ``sigma``; `temperature_coefficients`: what is added to a resistor's line, for ``tc1`` in 1/K and
    ``tc2`` in 1/K^2; `piecewise`: what is added to a source's line to make it move in time: ``points``, pairs of time
    and value; `small_signal`: what is added to the line of a source of 1 V in a small-signal analysis; `voltage`: the
    voltage between ``a`` and ``b`` in an expression; `expression`: how an expression ``value`` stands where a number
    would; `parameter`: definition of the parameter ``name``; `subcircuit, parameters, instance, end_subcircuit`: first
    line of a subcircuit (``name``, ``nodes``, ``defaults``), how its parameters are introduced (in the body or in that
    line, see `parameters_in_body`), an instance (``name``, ``nodes``, ``master``, ``values``), and the last line;
    `instance_parameters`: what stands in front of an instance's values; `parameters_in_body`: whether the parameters
    of a subcircuit stand in a line of their own; `include`: the statement that includes ``file``; `precise`: the
    options that make Newton's method agree to 1e-9 where there are nonlinear resistors; `end`: last line of a deck;
    may be empty; `commands`: the second file, that includes the deck and asks for its operating point: ``deck``, and
    ``source``, the name of a voltage source, with its ``volts``; `statements`: other analyses; `quirks`: where it
    errs; `nominal_temperature`: at which values hold unless a deck says otherwise, in degrees Celsius; `engines`:
    programs that run its decks here, and what they cost; `checks_itself`: whether its decks have a companion;
    `reading`: how its decks are read.
    """

    name: str
    label: str
    reserved: frozenset[str]
    commands: str
    statements: Statements
    quirks: Quirks
    ground: str = "0"
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
    voltage: str = "v({a},{b})"
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
    reading: ReadingRules | None = None
