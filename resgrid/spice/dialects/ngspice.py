"""ngspice: what its decks must respect, each learnt by experiment with version 39, and tried with 46.

- The first line of a file it is given is a title, whatever it says; in an included file it is not.  A full-line
  comment in front serves both.  A line that begins with ``*#`` is a command, not a comment.
- ``1M`` is a milliohm and ``1F`` a femto-anything: numbers are written plain.  They are read digit by digit, so a
  number of 17 digits arrives with an error of up to 2 units in the last place.
- Case is folded, and ``gnd`` is another name of node ``0``.
- A node that floats, if only behind a capacitor, makes the matrix singular.  ngspice then steps gmin and supplies,
  ends in a pseudo-transient, and reports, with exit status 0, the answer of a circuit with ``gmin`` (``.option
  gshunt`` or else ``.option gmin``, 1e-12 S without) from *every* node to ground.
- 0 ohm silently becomes 1 milliohm; smaller but positive values are kept.  Version 46 says that it is 1e-12 ohm, and
  loses nine digits to it.
- A second device of the same name, or a loop of voltage sources that ground is tied to, ends the run without an
  answer; a loop elsewhere is mostly answered rightly, but not always.
- A loop of inductors, or of inductors and sources, makes the matrix singular: the answer is what a transient comes to,
  which depends on their inductances and may be anything.
- Where a resistance is far smaller than everything else that holds its nodes, their difference drowns in its
  conductance: 1e-9 ohm behind 5 ohm costs a millionth of the voltage.
- A linear operating point is solved directly: ``gmin``, ``reltol``, ``abstol``, ``vntol``, ``pivtol`` and ``pivrel``
  change nothing (agreement is 1e-14 on uniform grids, 1e-10 where conductances span ten decades), ``rshunt=R``, which
  puts ``R`` from every node to ground, ruins it (1e-6), ``noopiter`` goes the way of the floating node.  So no option
  is set but ``klu``, the faster matrix package of newer versions, which older ones ignore; their own takes 0.4 s for
  64 x 64 cells, 11 s for 128 x 128.
- Printed numbers are cut to ``numdgt`` digits: only the binary raw file holds the voltages as they are.
  ``SPICE_ASCIIRAWFILE`` in the environment and a ``.spiceinit`` in the home folder can change what is written.
- In batch mode with a control block it may exit with status 1 after a perfect run: neither status says anything.
- A control block may run any shell command: no deck from elsewhere is simulated with one.
- Functions and what an ``X`` line gives are put in as text, so that names in them are looked up where they land;
  ``m=`` of an ``X`` line takes the place of that of the elements within; ``.end`` ends nothing; ``.temp`` counts before
  ``.option temp``; the first of two models counts; ``rsh`` counts before ``r``.  Where nobody can have meant it (a
  parameter that means another one where it lands), the deck is refused.
- Names of numparam's functions (``fmathS`` in ``src/frontend/numparam/xpressn.c``) are functions wherever they stand
  in an expression: ``.param max=5`` is lost, ``{max*100}`` is 0, ``{100*max}`` an error. ``temper`` is the simulation
  temperature whatever ``.param`` says, in the values of R, C, L and models only (``inp_fix_temper_in_param`` and
  ``b_transformation_wanted`` in ``inpcom.c``), where a B element evaluates it: without ``int``, ``arctan``, ``%``, a
  backslash and without a third argument of ``min`` and ``max``; ``time`` and ``hertz`` make a resistor fail;
  ``{last}`` is a word of ``.meas``. Constants (``pi``, ``e``, ``boltz``) are known to its commands and B elements, not
  to ``.param``.
- The name of a parameter ends at the first character that is no letter, digit or underscore: ``.param a.b=5`` defines
  ``a`` (``getword``).  ``min(a,b,c)`` compares ``a`` and ``c``.  An unquoted value ends at a blank, unless it is alone
  on its line and begins with a number.
- ``gnd`` between blanks, commas or parentheses becomes ``0`` in every line, in expressions as well
  (``inp_fix_gnd_name``). A line with the word ``temper`` becomes a B element, whatever the word names. A model called
  ``r`` is overlooked. The node ``null`` is the same one in every subcircuit (``gettrans`` in ``subckt.c``).
- Double quotes are dropped before expressions are looked for: ``"300+200"`` is 200 (39). Calls and first lines of
  subcircuits are read as meant.
- Every parameter is evaluated, needed or not.  A second definition of one makes ngspice forget another one, where that
  stands in a line without braces.
- No ``.meas`` is computed in a batch that writes a raw file, so that it is asked in a control block.

Engines: up to version 41 it orders its matrix by Markowitz's rule with linear searches; from version 42 on it has KLU,
as has ``eecircuit``, its WebAssembly.
"""

from __future__ import annotations

from resgrid.spice.dialects.record import (
    FUNCTIONS,
    SUFFIXES,
    Costs,
    Dialect,
    Quirks,
    ReadingRules,
    Refusals,
    Statements,
    Words,
)

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
    encodings=frozenset({"latin-1", "utf-16", "cr"}),
    commas=True,
    idle_parameters=True,
    redefinitions=True,
    keys={
        "r": frozenset({"ic", "isnoisy", "temp_ac"}),
        "c": frozenset({"ac", "isnoisy", "noise", "noisy", "temp_ac"}),
        "l": frozenset({"ac", "isnoisy", "noise", "noisy", "temp_ac"}),
        "v": frozenset({"m"}),
    },
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
    """How ngspice spells the name of an element: ``r1``, but ``r.x1.r1`` for one inside a subcircuit.

    Examples
    --------
    >>> ngspice_name("V1"), ngspice_name("X1.X2.Vdd")
    ('v1', 'v.x1.x2.vdd')
    """
    folded = name.lower()
    leaf = folded.rpartition(".")[2]
    return f"{leaf[:1]}.{folded}" if "." in folded else folded
