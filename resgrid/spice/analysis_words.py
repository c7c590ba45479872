"""The statements of analyses, dialect by dialect, as data.

Fields are those of `resgrid.spice.analyses`, and ``deck``, ``source`` (a voltage source of the deck, for analyses that
need one) and its ``volts``.  Sources: ngspice manual, chapter "Analyses and Output Control"; LTspice help, "Dot
Commands"; Xyce Reference Guide, chapter "Netlist Commands"; HSPICE Command Reference; Spectre Circuit Simulator
Reference, chapter "Analysis Statements".

ngspice computes no ``.meas`` in a batch that writes a raw file, so that it is asked in a control block.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any


@dataclass(frozen=True)
class AnalysisWords:
    """How one simulator is asked for analyses; templates for `str.format`, a line each.

    `first, last`: lines in front of all others, and behind them; `deck_first`: whether the deck is included before
    the statements, not after them; `operating, transient, noise, temperature, mismatch`: the analyses;
    ``temperatures`` is a list with blanks, and so is ``numbers``, of the runs; `run`: what starts the other analyses
    where one of them is a control block; `one_a_run`: whether the simulator runs one analysis only; `print_all`: what
    must be there for anything to be printed; ``kind`` is the analysis; `probe, probe_voltage, probe_current`: what is
    kept, a statement with ``what``, and how a voltage and a current stand in it; ``kind`` is the analysis; `maximum,
    minimum, value, crossing`: the measurements, by `Measure.what`; `measure_first, measure_last`: lines around the
    measurements.
    """

    first: tuple[str, ...]
    last: tuple[str, ...]
    deck_first: bool
    operating: tuple[str, ...]
    transient: tuple[str, ...]
    noise: tuple[str, ...]
    temperature: tuple[str, ...]
    mismatch: tuple[str, ...]
    run: tuple[str, ...]
    probe: str
    probe_voltage: str
    probe_current: str
    maximum: str
    minimum: str
    value: str
    crossing: str
    print_all: str = ""
    one_a_run: bool = False
    measure_first: tuple[str, ...] = ()
    measure_last: tuple[str, ...] = ()


_NGSPICE = AnalysisWords(
    first=("* ngspice -n -b -r analyses.raw {deck}.ngspice",),
    last=(".end",),
    deck_first=True,
    operating=(".op",),
    transient=(".tran {step} {stop} 0.0 {step}",),
    noise=(".noise v({node}) {source} dec {points} {start} {stop}",),
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
    probe_voltage="v({name})",
    probe_current="i({name})",
    measure_first=(".control", "run", "setplot tran1"),
    maximum="meas tran {name} max v({node})",
    minimum="meas tran {name} min v({node})",
    value="meas tran {name} find v({node}) at={at}",
    crossing="meas tran {name} when v({node})={at} cross=1",
    measure_last=(".endc",),
)
_STATEMENTS: dict[str, Any] = {
    "measure_first": (),
    "maximum": ".measure tran {name} max v({node})",
    "minimum": ".measure tran {name} min v({node})",
    "value": ".measure tran {name} find v({node}) at={at}",
    "crossing": ".measure tran {name} when v({node})={at} cross=1",
    "measure_last": (),
}
_LTSPICE = replace(
    _NGSPICE,
    **_STATEMENTS,
    run=(),
    one_a_run=True,
    first=("* LTspice -b {deck}.ltspice", ".options numdgt=15"),
    deck_first=False,
    temperature=(".op", ".step temp list {temperatures}"),
    mismatch=(".op", ".step param run 1 {runs} 1"),
)
_XYCE = replace(
    _NGSPICE,
    **_STATEMENTS,
    run=(),
    one_a_run=True,
    first=("* Xyce {deck}.xyce",),
    deck_first=False,
    operating=(".dc {source} {volts} {volts} 1.0",),
    noise=(".noise v({node}) {source} dec {points} {start} {stop}", ".print noise format=csv onoise inoise"),
    temperature=(".dc {source} {volts} {volts} 1.0", ".step temp list {temperatures}"),
    mismatch=(
        ".dc {source} {volts} {volts} 1.0",
        ".sampling useexpr=true",
        ".options samples numsamples={runs} seed={seed}",
    ),
    probe=".print {kind} format=csv precision=16 {what}",
    print_all=".print {kind} format=csv precision=16 v(*)",
)
_HSPICE = replace(
    _NGSPICE,
    **_STATEMENTS,
    run=(),
    first=("* hspice {deck}.hspice", ".option post=1 numdgt=10 ingold=2"),
    deck_first=False,
    transient=(".option delmax={step}", ".tran {step} {stop}"),
    noise=(".ac dec {points} {start} {stop}", ".noise v({node}) {source} {points}", ".print noise onoise"),
    temperature=(".dc temp poi {count} {temperatures}",),
    mismatch=(".option seed={seed}", ".dc monte={runs}"),
    probe=".probe {kind} {what}",
)
_SPECTRE = AnalysisWords(
    first=("// spectre {deck}.spectre", "simulator lang=spectre"),
    last=(),
    deck_first=True,
    run=(),
    operating=("operating_point dc oppoint=rawfile",),
    transient=("transient tran stop={stop} maxstep={step}",),
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
    **_STATEMENTS | {"measure_first": ("simulator lang=spice",), "measure_last": ("simulator lang=spectre",)},
)

ANALYSIS_WORDS = {
    "ngspice": _NGSPICE,
    "ltspice": _LTSPICE,
    "xyce": _XYCE,
    "hspice": _HSPICE,
    "spectre": _SPECTRE,
}
