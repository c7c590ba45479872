"""Sections of the report on a chip: results of the analyses, their figures with definitions, and pictures.

Also the limits on the effort of the analyses, estimates of their run times, and the names of their checkpoint files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from resgrid.chip.adc_resolution import ADCResolution
from resgrid.chip.build import value_text
from resgrid.chip.fault_analysis import FaultAnalysis
from resgrid.chip.figures_of_merit import Figure, Result, formatted
from resgrid.chip.plan_energy import energy_sentences
from resgrid.chip.study_analyses import Study, study
from resgrid.chip.sweeps import SweptKey
from resgrid.chip.yield_loss import loss_sentences, loss_table, usual_trials
from resgrid.core.random_sites import end_names
from resgrid.errors import CircuitError
from resgrid.scene.chip import Chip
from resgrid.scene.table_models import described_keys

_SWEEP_TRIALS = 32
"""Number of random chips for each pair of values in the sweep section."""

_NO_CAPACITANCE = "the chip has no capacitance; give chip.capacitance, such as 50f"
"""Reason why a chip has no settling time."""


@dataclass(frozen=True)
class Effort:
    """Limits on the effort of the analyses of a report.

    `half_width`: Monte Carlo trials stop when half the width of the confidence interval of the yield, as a fraction, is
    at most this; `trials`: maximum number of random chips; `seconds`: time limit of the fault analysis in seconds;
    `sweep`: two keys of the chip description to sweep, each with the list of its values, or empty for the default keys;
    `executor`: workers that run the trials, None for this process; `checkpoints`: files of trial results, by the name
    of the analysis (``yield``, ``sweep``); `progress`: function called with the numbers of finished and of all trials
    or elements, and (for trials) the yield so far.
    """

    half_width: float = 0.01
    trials: int = 2000
    seconds: float = 60.0
    sweep: Sequence[SweptKey] = ()
    executor: Executor | None = None
    checkpoints: Mapping[str, Path] = field(default_factory=dict)
    progress: Callable[..., None] | None = None


USUAL = Effort()
"""Default limits on the trials and the time of the analyses of a report."""


@dataclass(frozen=True)
class Picture:
    """A picture of a report.

    `name`: file name without suffix; `caption`: description; `value, options`: positional argument and keyword
    arguments of `resgrid.draw`; `is_map`: whether the picture shows cells, which needs a space of two axes.
    """

    name: str
    caption: str
    value: Any
    options: Mapping[str, Any] = field(default_factory=dict)
    is_map: bool = True


@dataclass(frozen=True, eq=False)
class Section:
    """Result of one analysis, as a section of a report.

    `name`: name of the analysis; `text`: sentences, the first of which is the main result; `figures`: figures of merit
    by name; `pictures`: pictures; `data`: values for JSON (numbers, texts, lists, dictionaries); `table`: lines of a
    Markdown table, empty without a table.
    """

    name: str
    text: tuple[str, ...]
    figures: Mapping[str, Figure] = field(default_factory=dict)
    pictures: tuple[Picture, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    table: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Title of the section for a heading: the name of the analysis, with spaces and a capital."""
        return self.name.replace("_", " ").capitalize()


def _section(name: str, result: Result, text: Sequence[str], *pictures: Picture) -> Section:
    """Return the section of a result; `name`: name of the analysis; `text`: sentences, the main result first."""
    return Section(name, tuple(text), result.figures, pictures, result.to_json())


def _missing(name: str, reason: str) -> Section:
    """Return a section that states the `reason` (a clause) why the analysis `name` is impossible for this chip."""
    return Section(name, (f"Not analysed: {reason}.",), data={"reason": reason})


def yield_section(chip: Study, effort: Effort) -> Section:
    """Return the section on the yield: the fraction of starts from which robots reach a goal, over many chips.

    `chip`: the chip under study; `effort`: limits on the trials.
    """
    result = chip.yields(
        half_width=effort.half_width,
        trials=effort.trials,
        executor=effort.executor,
        checkpoint=effort.checkpoints.get("yield"),
        progress=effort.progress,
    )
    overall = result.overall
    interval = f" ({100 * overall.low:.1f} to {100 * overall.high:.1f} %)" if result.random else ""
    tried = "This chip has no random errors, so that one chip gives the exact yield."
    if result.random:
        seed = 0 if chip.chip is None else chip.chip.seed
        tried = f"{result.trials} chips of seed {seed} were tried; intervals are Wilson intervals at 95 %."
    text = (
        f"A robot that sees only the read-out reaches a goal from {100 * overall.value:.4g} % of the starts{interval}; "
        f"{100 * result.perfect.value:.4g} % of the chips serve every start.",
        "In each cell the robot measures the nodes of the cell and of its free neighbours, and steps to the lowest "
        "reading if that is below the reading of the cell. A robot that is stuck or returns to a cell is lost.",
        tried,
    )
    return _section(
        "yield", result, text, Picture("yield", "fraction of the chips on which each start reaches a goal", result)
    )


def yield_loss_section(chip: Study, effort: Effort) -> Section:
    """Return the section on the loss of yield by each effect, and on the limits of mismatch, offset and bits.

    `chip`: the chip under study; `effort`: limits on the trials.
    """
    trials = min(usual_trials(chip.ideal.cells.space), effort.trials)
    result = chip.yield_loss(trials=trials, executor=effort.executor, progress=effort.progress)
    section = _section("yield_loss", result, loss_sentences(result))
    if not result.causes:
        return section
    picture = Picture("yield_loss", "change of the yield when an effect is switched off", result, is_map=False)
    return replace(section, table=loss_table(result), pictures=(picture,))


def adc_resolution_section(chip: Study, _effort: Effort) -> Section:
    """Return the section on the converter bits that starts need, for each boundary condition of obstacles.

    The boundary condition of the scene comes first.  The other conditions follow if a source then drives the circuit.
    """
    results = _by_boundary(chip)
    own = next(iter(results.values()))
    needed = own.bits_for(0.99)
    text = (
        f"{own.sentence(chip.bits).capitalize()}; "
        + (f"99 % of them need {needed} bits." if needed is not None else "no number of bits serves 99 % of them."),
        "This includes the converter only: no offset, no noise, and a single chip. The other boundaries show the bits "
        "that the same chip needs with open obstacles (neumann) or obstacles with a series resistance (wall).",
    )
    caption = "bits that every start needs, their histogram, and the fraction of starts that a read-out serves"
    picture = Picture("adc_resolution", caption, results, {"bits": chip.bits})
    data = {"boundaries": {name: result.to_json() for name, result in results.items()}}
    return Section("adc_resolution", text, own.figures, (picture,), data)


def _by_boundary(chip: Study) -> dict[str, ADCResolution]:
    """Return the converter bits that starts need, by boundary condition, the scene's own condition first.

    Keys: ``"dirichlet"``, ``"neumann"`` and ``"wall"``.  A condition is left out if no source drives the circuit, and
    ``"wall"`` also if the chip description has no wall resistance.  All circuits belong to one chip (one seed).
    """
    cells = chip.ideal.cells
    results: dict[str, ADCResolution] = {cells.wiring.boundary: chip.adc_resolution()}
    for boundary in ("dirichlet", "neumann", "wall"):
        walled = chip.chip is not None and chip.chip.wall_resistance is not None
        if boundary in results or (boundary == "wall" and not walled):
            continue
        try:
            other = study(cells.space, chip.chip, boundary=boundary, edge=cells.wiring.edge, leak=cells.wiring.leak)
            results[boundary] = other.adc_resolution(span=chip.span)
        except CircuitError:  # no drive at this boundary
            continue
    return results


def settling_section(chip: Study, _effort: Effort) -> Section:
    """Return the section on the settling time, and on the energy of one settling after the supplies are switched on."""
    if not chip.netlist.capacitance.any():
        return _missing("settling", _NO_CAPACITANCE)
    result = chip.usual_settling
    text = (
        f"Every node settles to {result.bits} bits within {formatted(result.settle_time, 's')} after the supplies are "
        f"switched on; a plan costs {formatted(result.energy, 'J')} until then.",
        *_linearization(chip),
    )
    curve = "largest distance of a node from its final voltage"
    return _section(
        "settling",
        result,
        text,
        Picture("settling", "settling time of each cell", result),
        Picture("settling_curve", curve, result, {"quantity": "curve"}, is_map=False),
    )


def plan_energy_section(chip: Study, _effort: Effort) -> Section:
    """Return the section on the energy and time of a plan, compared with a published digital processor."""
    if not chip.netlist.capacitance.any():
        return _missing("plan_energy", _NO_CAPACITANCE)
    result, shape = chip.plan_energy(), chip.ideal.cells.space.shape
    return _section("plan_energy", result, energy_sentences(result, chip.description.readout, shape))


def noise_section(chip: Study, _effort: Effort) -> Section:
    """Return the section on the thermal noise of the node voltages, in volts and in steps of the converter."""
    bandwidth = None if chip.chip is None else chip.chip.readout.noise_bandwidth
    if bandwidth is None and not chip.netlist.capacitance.any():
        why = "neither a noise bandwidth nor a capacitance limits the noise; give chip.readout.noise_bandwidth"
        return _missing("noise", why)
    result = chip.noise()
    assert result.total is not None
    assert result.band is not None
    worst, step = float(np.nanmax(result.total)), (chip.span or 1.0) / 2.0**chip.bits
    text = (
        f"The noisiest node has {formatted(worst, 'V')} rms in the band up to {formatted(result.band[1], 'Hz')}, "
        f"{worst / step:.2g} steps of a {chip.bits}-bit converter.",
        *_linearization(chip),
    )
    return _section("noise", result, text, Picture("noise", "rms noise of every cell in that band", result))


def _linearization(chip: Study) -> tuple[str, ...]:
    """Return a tuple with a sentence on the linearization if the chip has nonlinear resistors, else an empty tuple."""
    if not chip.netlist.nonlinear_nodes.size:
        return ()
    return ("The resistors saturate: the result holds for small signals around the operating point.",)


def power_section(chip: Study, _effort: Effort) -> Section:
    """Return the section on the power of the chip, and on the supply droop at its obstacle and goal cells."""
    result = chip.power()
    text = [f"The chip takes {formatted(result.total, 'W')} once it has settled."]
    pictures = [Picture("power", "heat by cell, and the hottest resistors", result)]
    if result.largest_droop > 0:
        text.append(
            f"The resistance of switches and rails moves obstacle and goal cells by up to "
            f"{formatted(result.largest_droop, 'V')} from the voltage of their rail."
        )
        caption = "voltage between each obstacle or goal cell and its rail"
        pictures.append(Picture("droop", caption, result, {"quantity": "droop"}))
    return _section("power", result, text, *pictures)


def sensitivity_section(chip: Study, _effort: Effort) -> Section:
    """Return the section on the resistors whose relative change (drift) alters a step of the robot on the chip."""
    result = chip.sensitivity()
    starts = 0 if chip.scene is None else len(chip.scene.starts)
    origin = {0: "the start that needs most bits", 1: "the start"}.get(starts, f"the {starts} starts")
    flips = len(result.flips(0.01))
    text = (
        f"On the path from {origin}, {flips or 'no'} resistor{'s' if flips != 1 else ''} can change one of "
        f"the robot's steps by a drift of 1 %{' each' if flips > 1 else ''}.",
        f"The {len(result.cells)} steps of the path lead to the lowest neighbour. A resistor changes one if it brings "
        "the second lowest to the same voltage. A robot may still reach the goal after a changed step.",
    )
    caption = "resistors by the drift that changes a step"
    return _section("sensitivity", result, text, Picture("sensitivity", caption, result))


def sweep_section(chip: Study, effort: Effort) -> Section:
    """Return the section on the yield for all pairs of values of two keys of the chip description.

    `chip`: the chip under study; `effort`: `effort.sweep` gives the keys and values; workers and checkpoint of the
    trials.
    """
    result = chip.sweep(
        *effort.sweep,
        trials=_SWEEP_TRIALS,
        executor=effort.executor,
        checkpoint=effort.checkpoints.get("sweep"),
        progress=effort.progress,
    )
    units = described_keys(Chip)
    first, second = (units[key][0] for key in (result.first, result.second))
    least = ", ".join(
        f"{value_text(value, first)}: {'none tried' if cost is None else value_text(cost, second)}"
        for value, cost in zip(result.first_values, result.cheapest(0.99), strict=True)
    )
    text = (
        f"The least `{result.second}` that serves 99 % of the starts, by `{result.first}`: {least}.",
        f"{result.trials} chips at every point, the same dies throughout.",
    )
    caption = "yield over two values of the chip"
    return _section("sweep", result, text, Picture("sweep", caption, result, is_map=False))


def defects_section(chip: Study, effort: Effort) -> Section:
    """Return the section on the number of starts that are lost by single open or shorted elements.

    `chip`: the chip under study; `effort`: gives the time limit.
    """
    result = chip.faults(seconds=effort.seconds, progress=effort.progress)
    opened, shorted = (int((np.nan_to_num(result.lost(fault)) > 0).sum()) for fault in ("open", "short"))
    seen = "an ideal read-out" if result.ideal else f"the {result.bits}-bit converter without offset and noise"
    text = [
        f"Of {result.examined} resistors, switches and rail segments, {opened} cost at least one of the "
        f"{result.served} served starts when they are open, and {shorted} when they are shorted.",
        "Each fault is an exact update of the solution, followed by a new walk from every start; the robot sees "
        f"{seen}.",
        _worst(result),
    ]
    if result.examined < len(result.open):
        text.append(
            f"Only {result.examined} of {len(result.open)} elements, those with the largest currents, fit in --seconds."
        )
    pictures = (
        Picture(f"{fault}s", f"starts lost when an element is {state}", result, {"fault": fault})
        for fault, state in (("open", "open"), ("short", "shorted"))
    )
    return _section("defects", result, text, *pictures)


def _worst(result: FaultAnalysis) -> str:
    """Return a sentence on the most harmful open and the most harmful short of a single element.

    A fault is the more harmful, the more starts that reach a goal on the faultless chip do not reach one with the
    fault.  The sentence names the nodes of both elements, and the numbers of lost starts.
    """
    words = []
    for fault in ("open", "short"):
        worst = result.worst(fault, 1)
        for (first, second), lost in zip(end_names(result.netlist, worst), result.lost(fault)[worst], strict=True):
            words.append(f"the worst {fault} lies between {first} and {second}, with {int(lost)} starts lost")
    return "; ".join(words).capitalize() + "." if words else "No fault costs a start."


SECTIONS: dict[str, Callable[[Study, Effort], Section]] = {
    "yield": yield_section,
    "yield_loss": yield_loss_section,
    "adc_resolution": adc_resolution_section,
    "settling": settling_section,
    "plan_energy": plan_energy_section,
    "noise": noise_section,
    "power": power_section,
    "sensitivity": sensitivity_section,
    "sweep": sweep_section,
    "defects": defects_section,
}
"""Functions that return the section of each analysis, by the name of the analysis, in the order of the report."""


def report_section(name: str, chip: Study, effort: Effort = USUAL) -> Section:
    """Return the section of the analysis `name`; pictures of cells are left out unless the space has two axes.

    `chip`: the chip under study; `effort`: limits on the trials and the time.
    """
    section = SECTIONS[name](chip, effort)
    is_plane = chip.ideal.cells.space.ndim == 2
    return replace(section, pictures=tuple(item for item in section.pictures if is_plane or not item.is_map))


def seconds_needed(name: str, chip: Study, effort: Effort) -> float:
    """Return a rough estimate of the time that the analysis `name` takes, in seconds; 0 if it is negligible.

    `chip`: the chip under study; `effort`: limits on the trials and the time.
    """
    nodes = chip.netlist.node_count
    known = {"settling": 1 + 2e-5 * nodes, "noise": 1 + 2e-4 * nodes, "sensitivity": 1 + 1e-4 * nodes, "yield": 2.0}
    return known.get(name, {"sweep": 5.0, "yield_loss": 3 + 6e-3 * nodes, "defects": effort.seconds}.get(name, 0.0))


def checkpoints_beside(folder: Path, chip: Study, sweep: Sequence[SweptKey]) -> dict[str, Path]:
    """Return the paths of the files of trial results next to a report folder, under the keys ``yield`` and ``sweep``.

    The file names contain a hash of the chip description, the space and the sweep.  `folder`: folder of the report;
    `chip`: the chip under study; `sweep`: keys of the chip description to sweep, each with the list of its values.
    """
    cells = chip.ideal.cells
    space, keys = cells.space, asdict(chip.chip or Chip())  # a repr would truncate long lists
    digest = hashlib.sha256(f"{keys} {cells.wiring} {sweep} {space.axes}".encode() + space.cell.tobytes())
    if space.conductivity is not None:
        digest.update(space.conductivity.tobytes())
    mark = digest.hexdigest()[:12]
    return {name: folder.parent / f".{folder.name}-{mark}.{name}.jsonl" for name in ("yield", "sweep")}
