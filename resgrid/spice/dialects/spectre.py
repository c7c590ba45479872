"""Dialect of Spectre as data: rules of its decks, from its reference manuals; Spectre was not run.

- Its language is not SPICE: ``name (nodes) master parameter=value``, ``//`` comments, and a line ``simulator
  lang=spectre``.
- Names are case-sensitive; ``M`` is mega and ``m`` milli, unlike in SPICE; ``1meg`` is not a number.
- Subcircuit parameters are declared in the body, after ``parameters``.  Mismatch varies per subcircuit instance, so
  every resistor becomes an instance.
- The language has no end statement and no measurements (those belong to MDL): files of commands hold analyses only.
- ``gmin``, a conductance to ground, is added at the floating nodes only, with a message.
- ``temp``, ``tnom``, ``scale``, ``scalem``, ``freq`` and ``time`` are predefined parameters, ``M_...`` and ``P_...``
  constants (Spectre Circuit Simulator Reference, "Expressions"); a deck that redefines one, or gives a parameter a word
  of the language as its name, is rejected.
"""

from __future__ import annotations

import math

from resgrid.spice.dialects.record import Dialect, Quirks, ReadingRules, Statements, Words
from resgrid.spice.dialects.refusals import LTSPICE_COMMANDS, Refusals

_RESERVED = frozenset(
    """
    gnd ground and correlate else end ends export for function global ic if inline library local march model
    nodeset or parameters paramset plot print protect pwr real return save section sens simulator statistics
    subckt to truncate unprotect vary info altergroup ahdl_include include
    """.split()  # noqa: SIM905
)

_CONSTANTS = {
    "M_E": math.e,
    "M_LOG2E": math.log2(math.e),
    "M_LOG10E": math.log10(math.e),
    "M_LN2": math.log(2),
    "M_LN10": math.log(10),
    "M_PI": math.pi,
    "M_TWO_PI": 2 * math.pi,
    "M_PI_2": math.pi / 2,
    "M_PI_4": math.pi / 4,
    "M_1_PI": 1 / math.pi,
    "M_2_PI": 2 / math.pi,
    "M_2_SQRTPI": 2 / math.sqrt(math.pi),
    "M_SQRT2": math.sqrt(2),
    "M_SQRT1_2": math.sqrt(0.5),
    "M_DEGPERRAD": 180 / math.pi,
    "P_CELSIUS0": 273.15,
}
_VARIABLES = {
    "time": "the time",
    "freq": "the frequency",
    "scale": "the scale of lengths",
    "scalem": "the scale of models' lengths",
    **dict.fromkeys(
        ("P_Q", "P_C", "P_K", "P_H", "P_EPS0", "P_U0"), "a physical constant, whose digits differ between versions"
    ),
}
_WORDS = Words(
    functions=frozenset(
        """
        abs acos acosh asin asinh atan atan2 atanh ceil cos cosh exp floor fmod hypot int log log10 max min pow sin
        sinh sqrt tan tanh
        """.split()  # noqa: SIM905
    ),
    constants=_CONSTANTS,
    temperature=frozenset({"temp"}),
    nominal=frozenset({"tnom"}),
    variables=_VARIABLES,
    undefinable=frozenset({"temp", "tnom", *_VARIABLES, *_CONSTANTS, *_RESERVED}) - {"info", "or", "and"},
)

SPECTRE = Dialect(
    name="spectre",
    label="Spectre",
    reserved=_RESERVED,
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
    piecewise=" type=pwl wave=[{points}]",
    small_signal=" mag=1",
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
    statements=Statements(
        first=("// spectre {deck}.spectre", "simulator lang=spectre"),
        last=(),
        deck_first=True,
        operating=("operating_point dc oppoint=rawfile",),
        transient=("transient tran stop={stop} maxstep={step}",),
        charged=(
            "precise options reltol={reltol} vabstol={vntol} iabstol={abstol}",
            "transient tran stop={stop} maxstep={step} skipdc=yes",
        ),
        noise=("noise_at_node ({node} 0) noise start={start} stop={stop} dec={points} iprobe={source}",),
        temperature=(
            "temperatures sweep param=temp values=[{temperatures}] {{",
            "  temperature_point dc oppoint=rawfile",
            "}}",
        ),
        mismatch=(
            "mismatches montecarlo numruns={runs} seed={seed} variations=mismatch savefamilyplots=yes {{",
            "  mismatch_point dc oppoint=rawfile",
            "}}",
        ),
        probe="save {what}",
        probe_voltage="{name}",
        probe_current="{name}:p",
        measure_first=("simulator lang=spice",),
        measure_last=("simulator lang=spectre",),
    ),
    quirks=Quirks(floating="there"),
    reading=ReadingRules(
        name="spectre",
        signs=(b"simulator lang",),
        suffix=".scs",
        comments=("//",),
        suffixes={"T": 12, "G": 9, "M": 6, "K": 3, "k": 3, "m": -3, "u": -6, "n": -9, "p": -12, "f": -15, "a": -18},
        grounds=frozenset({"0"}),
        ignored_model_keys=dict.fromkeys(("rsh", "l", "w", "narrow", "short", "etch", "etchl", "scaler"), ""),
        instances=True,
        inductor_keys=frozenset({"r"}),
        words=_WORDS,
        refusals=Refusals(letters="unsure"),
        spice=ReadingRules(
            name="spectre",
            comments=("//", ";"),
            dollar_comments=True,
            grounds=frozenset({"0"}),
            words=_WORDS,
            refusals=Refusals(foreign_commands=LTSPICE_COMMANDS | {".step"}, blank_names="unsure", letters="unsure"),
        ),
    ),
)
