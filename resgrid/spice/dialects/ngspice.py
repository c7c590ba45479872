"""Dialect of ngspice as data: rules of its decks, found by experiment with version 39, confirmed with 46.

- The first line of the main file is always read as the title; that of an included file is not.  A full-line comment as
  first line serves both cases.  A line that begins with ``*#`` is a command, not a comment.
- ``1M`` is a milliohm and ``1F`` means 1e-15: numbers are written without suffixes.  They are read digit by digit, so a
  number of 17 digits is read with an error of up to 2 units in the last place.
- Case is folded, and ``gnd`` is another name of node ``0``.
- A floating node, including one that only a capacitor ties, makes the matrix singular.  ngspice then steps gmin and
  supplies, ends in a pseudo-transient, and reports, with exit status 0, the result of a circuit with ``gmin``
  (``.option gshunt``, else ``.option gmin``, else 1e-12 S) from *every* node to ground.
- 0 ohm silently becomes 1 milliohm; smaller positive values are kept.  Version 46 reports 1e-12 ohm, which costs nine
  digits of accuracy.
- A second device of the same name, or a loop of voltage sources tied to ground, ends the run without a result.  Other
  loops of voltage sources are usually, but not always, solved correctly.
- A loop of inductors, or of inductors and sources, makes the matrix singular.  The result is the end of a transient,
  which depends on their inductances and may be arbitrary.
- A resistance much smaller than all others at its nodes causes cancellation: 1e-9 ohm in series with 5 ohm gives a
  relative voltage error of 1e-6.
- A linear operating point is solved directly: ``gmin``, ``reltol``, ``abstol``, ``vntol``, ``pivtol`` and ``pivrel``
  have no effect (agreement is 1e-14 on uniform grids, 1e-10 with conductances over ten orders of magnitude).
  ``rshunt=R``, which adds ``R`` from every node to ground, spoils the result (error 1e-6); ``noopiter`` has the effect
  of a floating node.  The only option set is therefore ``klu``, the faster matrix package of newer versions, which
  older ones ignore; their own takes 0.4 s for 64 x 64 cells, 11 s for 128 x 128.
- Printed numbers are cut to ``numdgt`` digits: only the binary raw file holds full precision.
  ``SPICE_ASCIIRAWFILE`` in the environment and a ``.spiceinit`` in the home folder can change the output format.
- In batch mode with a control block the exit status may be 1 after a correct run: the exit status carries no
  information.
- A control block can run any shell command: a foreign deck with a control block is never simulated.
- Functions and the values of an ``X`` line are substituted as text, so that their names are looked up in the place of
  substitution; ``m=`` of an ``X`` line replaces that of the elements in the subcircuit; lines after ``.end`` are read;
  ``.temp`` overrides ``.option temp``; the first of two models of one name is used; ``rsh`` overrides ``r``.  If a
  parameter's name has another meaning in the place of substitution, the deck is rejected.
- Names of numparam's functions (``fmathS`` in ``src/frontend/numparam/xpressn.c``) are functions wherever they occur
  in an expression: ``.param max=5`` is lost, ``{max*100}`` is 0, ``{100*max}`` an error. ``temper`` is the simulation
  temperature even if ``.param`` redefines it, in the values of R, C, L and models only (``inp_fix_temper_in_param`` and
  ``b_transformation_wanted`` in ``inpcom.c``), where a B element evaluates it: without ``int``, ``arctan``, ``%``, a
  backslash and without a third argument of ``min`` and ``max``; ``time`` and ``hertz`` make a resistor fail;
  ``{last}`` is a word of ``.meas``.  Constants (``pi``, ``e``, ``boltz``) are defined in commands and B elements, not
  in ``.param``.
- The name of a parameter ends at the first character that is not a letter, digit or underscore: ``.param a.b=5``
  defines ``a`` (``getword``).  ``min(a,b,c)`` compares ``a`` and ``c``.  An unquoted value ends at a blank, unless it
  is the only one on its line and begins with a number.
- A call of a ``.func`` is not recognised directly after ``!``, ``%``, ``&&`` or ``?``, with or without blanks, because
  these characters may be part of a name (``VALIDCHARS`` in ``inpcom.c``): ``{1&&f(1)}`` is an error, also in a
  parameter that is not used, and ``{!abs(0)}`` calls ngspice's ``abs`` in place of a ``.func`` of this name.
- ``gnd`` between blanks, commas or parentheses becomes ``0`` in every line, in expressions as well
  (``inp_fix_gnd_name``).  A line with the word ``temper`` becomes a B element, even if the word is the name of a node.
  A model called ``r`` is ignored.  The node ``null`` is global: all subcircuits share it (``gettrans`` in
  ``subckt.c``).
- Double quotes are removed before expressions are parsed: ``"300+200"`` is 200 (39).  Calls and first lines of
  subcircuits are read correctly.
- Every parameter is evaluated, also unused ones.  A second definition of a parameter makes ngspice lose another
  parameter that is used in a line without braces.
- ``.meas`` is not computed in a batch run that writes a raw file, so measurements are requested in a control block.

Engines: up to version 41 ngspice orders its matrix by Markowitz's rule with linear searches; from version 42 on it has
KLU, as has ``eecircuit``, its WebAssembly build.
"""

from __future__ import annotations

from resgrid.spice.dialects.record import FUNCTIONS, SUFFIXES, Costs, Dialect, Quirks, ReadingRules, Statements, Words
from resgrid.spice.dialects.refusals import Refusals

_WORDS = Words(
    functions=frozenset(
        """
        sqr sqrt sin cos exp ln arctan abs pow pwr max min int log log10 sinh cosh tanh ternary_fcn agauss sgn gauss
        unif aunif limit ceil floor asin acos atan asinh acosh atanh tan nint
        """.split()  # noqa: SIM905
    ),
    temperature=frozenset({"temper"}),
    variables={"time": "the time", "hertz": "the frequency", "last": "a word of .meas", "gnd": "ground"},
    temperature_in_values=True,
    cold=frozenset({"int", "arctan", "%", "\\"}),
    loose="numeric",
    loose_functions=True,
    redefines_functions=True,
    ends_of_three=True,
    exponential_coefficient=True,
    model_aliases={"resistance": "r"},
    inner_names=True,
    joins_brackets=True,
    misread={
        "node": frozenset({"temper"}),
        "model": frozenset({"gnd", "hertz", "r", "temper", "time"}),
        "subcircuit": frozenset({"gnd", "temper"}),
    },
    common_nodes=frozenset({"null"}),
    drops_quotes=True,
)
_REFUSALS = Refusals(
    commands=frozenset(
        """
        .backanno .connect .data .enddata .fft .global_param .graph .hb .loadbias .machine .mc .preprocess .protect
        .sampling .savebias .step .unprotect .variation .wave .wcase
        """.split()  # noqa: SIM905
    ),
    blank_names="fails",
    encodings=frozenset({"bom", "latin-1", "utf-16", "cr"}),
    commas=True,
    idle_parameters=True,
    redefinitions=True,
    glued_names=True,
    loose_libraries=True,
    keys={
        "r": frozenset({"ic", "isnoisy", "temp_ac"}),
        "c": frozenset({"ac", "isnoisy", "noise", "noisy", "temp_ac"}),
        "l": frozenset({"ac", "isnoisy", "noise", "noisy", "temp_ac"}),
        "v": frozenset({"m"}),
    },
    before_calls=frozenset({"!", "%", "&&", "?"}),
    commands_in_comments=rb"^[ \t]*\*#",
)

_STATEMENTS = Statements(
    first=("* ngspice -n -b -r {results}.raw {deck}.ngspice",),
    deck_first=True,
    operating=(".options klu", ".op"),
    temperature=(
        ".control",
        "foreach celsius {temperatures}",
        "  set temp = $celsius",
        "  op",
        "  write celsius.raw.$celsius",
        "end",
        "set temp = 27.0",
        ".endc",
    ),
    mismatch=(
        ".control",
        "setseed {seed}",
        "foreach run {numbers}",
        "  mc_source",
        "  op",
        "  write run.raw.$run",
        "end",
        ".endc",
    ),
    charged=(
        ".options reltol={reltol} abstol={abstol} vntol={vntol} chgtol={chgtol} trtol=1",
        ".tran {step} {stop} 0.0 {step} uic",
    ),
    run=(".control", "run", "write analyses.raw", ".endc"),
    probe=".save {what}",
    measure_first=(".control", "run", "setplot tran1"),
    maximum="meas tran {name} max v({node})",
    minimum="meas tran {name} min v({node})",
    value="meas tran {name} find v({node}) at={at}",
    crossing="meas tran {name} when v({node})={at} cross=1",
    measure_last=(".endc",),
)

NGSPICE = Dialect(
    name="ngspice",
    label="ngspice",
    reserved=frozenset({"gnd", "temper"}),
    statements=_STATEMENTS,
    quirks=Quirks(
        basis="measured",
        smallest_resistance=1e-3,
        raises_zero_only=True,
        floating="everywhere",
        shunt_options={"rshunt": "ohms"},
        duplicates="fails",
        gmin_options=("gshunt", "gmin"),
        loops="fail at ground",
    ),
    engines={
        "ngspice": Costs(0.02, 2.5e-6, 1.33e-8, 3.5, 0.6, 12e6, 1.2e3),
        "eecircuit": Costs(1.0, 2.5e-5, 1.0e-8, 2.0, 0.5, 300e6, 2.0e3),
        "ngspice-klu": Costs(0.02, 2.0e-5, 1.0e-8, 2.0, 0.5, 12e6, 1.5e3),
    },
    checks_itself=True,
    reading=ReadingRules(
        name="ngspice",
        comments=(";", "//"),
        dollar_comments=True,
        functions={
            **{name: name for name in FUNCTIONS if name not in ("atan2", "hypot")},
            "log": "ln",
            "arctan": "atan",
            "nint": "nint",
            "ternary_fcn": "if",
        },
        milli_mil=True,
        powers=frozenset({"**", "^"}),
        lengths_twice=True,
        operators={"%": "% of the quotient", "\\": "\\ of the magnitude"},
        narrow_parser=True,
        puts_in_text=True,
        replaces_multipliers=True,
        end_is_comment=True,
        first_counts=True,
        temp_command_first=True,
        braced_temperatures=True,
        sheet_first=True,
        models_first=True,
        parameters_first=True,
        ignored_model_keys={"defl": "l", "dl": "short", "tref": "tnom"},
        spaced_lists=True,
        scale_key=True,
        refused_options=frozenset({"rseries"}),
        suffixes={letters: power for letters, power in SUFFIXES.items() if letters != "\N{GREEK SMALL LETTER MU}"},
        words=_WORDS,
        refusals=_REFUSALS,
    ),
)


def ngspice_name(name: str) -> str:
    """Return ngspice's name of an element, in lower case: ``r1`` at the top level, ``r.x1.r1`` inside a subcircuit.

    `name`: name of the element in a `Circuit`, with the path of its subcircuit, such as ``X1.R1``.

    Examples
    --------
    >>> ngspice_name("V1"), ngspice_name("X1.X2.Vdd")
    ('v1', 'v.x1.x2.vdd')
    """
    folded = name.lower()
    leaf = folded.rpartition(".")[2]
    return f"{leaf[:1]}.{folded}" if "." in folded else folded
