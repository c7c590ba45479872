"""The page about a chip, as Markdown: what every analysis says, its figures with definitions, pictures, decks."""

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
from resgrid.chip.figures_of_merit import Figure, Result, figure_lines, formatted, table_lines
from resgrid.chip.study_analyses import Study, study
from resgrid.chip.sweeps import SweptKey
from resgrid.chip.yield_loss import loss_sentences, loss_table, usual_trials
from resgrid.core.random_sites import end_names
from resgrid.errors import CircuitError
from resgrid.scene.chip import Chip
from resgrid.scene.table_models import described_keys

_EXPLORED = 32
_DECKS = (
    "Every deck has its expected answer in the sidecar of the same name and `.json`; the file ending in `.ngspice` (or "
    "the dialect's name) runs it, and says in its first lines how. Node `n_3_7` is that of cell (3, 7), counted from 0."
)


@dataclass(frozen=True)
class Effort:
    """How far the analyses of a report go.

    `half_width`: of the yield's interval; `trials`: most chips that are tried; `seconds`: for making elements faulty;
    `sweep`: values to explore, none or two; `executor`: shares trials; `checkpoints`: files of their results, by
    the name of the analysis; `progress`: called with what is done, what there is in all, and a yield so far.
    """

    half_width: float = 0.01
    trials: int = 2000
    seconds: float = 60.0
    sweep: Sequence[SweptKey] = ()
    executor: Executor | None = None
    checkpoints: Mapping[str, Path] = field(default_factory=dict)
    progress: Callable[..., None] | None = None


USUAL = Effort()


@dataclass(frozen=True)
class Picture:
    """A picture of a report: file name without suffix, what it shows, and what `resgrid.draw` takes.

    `is_map`: whether it needs two axes.
    """

    name: str
    caption: str
    value: Any
    options: Mapping[str, Any] = field(default_factory=dict)
    is_map: bool = True


@dataclass(frozen=True, eq=False)
class Section:
    """What one analysis has to say.

    `text`: sentences, of which the first is the answer; `data`: for JSON; `table`: Markdown, line by line.
    """

    name: str
    text: tuple[str, ...]
    figures: Mapping[str, Figure] = field(default_factory=dict)
    pictures: tuple[Picture, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    table: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """For a heading."""
        return self.name.replace("_", " ").capitalize()


def _section(name: str, result: Result, text: Sequence[str], *pictures: Picture) -> Section:
    return Section(name, tuple(text), result.figures, pictures, result.to_json())


def _missing(name: str, reason: str) -> Section:
    return Section(name, (f"Not analysed: {reason}.",), data={"reason": reason})


def yield_section(chip: Study, effort: Effort) -> Section:
    """From how many starts robots reach a goal, on how many chips."""
    result = chip.yields(
        half_width=effort.half_width,
        trials=effort.trials,
        executor=effort.executor,
        checkpoint=effort.checkpoints.get("yield"),
        progress=effort.progress,
    )
    overall = result.overall
    known = f" ({100 * overall.low:.1f} to {100 * overall.high:.1f} %)" if result.random else ""
    tried = "Nothing about this chip is random, so one chip says it all."
    if result.random:
        seed = 0 if chip.chip is None else chip.chip.seed
        tried = f"{result.trials} chips of seed {seed} were tried; intervals are those of Wilson at 95 %."
    text = (
        f"A robot that sees only the read-out reaches a goal from {100 * overall.value:.4g} % of the starts{known}; "
        f"{100 * result.perfect.value:.4g} % of the chips serve every start.",
        "In each cell it measures its own node and those of the free neighbours, and steps to the lowest reading if "
        "that is strictly lower than its own; stuck, or back where it has been, it is lost.",
        tried,
    )
    return _section("yield", result, text, Picture("yield", "chips on which each start is served", result))


def yield_loss_section(chip: Study, effort: Effort) -> Section:
    """What each effect costs, and how large mismatch and offset may be."""
    trials = min(usual_trials(chip.ideal.cells.space), effort.trials)
    result = chip.yield_loss(trials=trials, executor=effort.executor, progress=effort.progress)
    section = _section("yield_loss", result, loss_sentences(result))
    if not result.causes:
        return section
    picture = Picture("yield_loss", "change of the yield when an effect is switched off", result, is_map=False)
    return replace(section, table=loss_table(result), pictures=(picture,))


def adc_resolution_section(chip: Study, _effort: Effort) -> Section:
    """How many converter bits starts need, at every boundary."""
    results = _by_boundary(chip)
    own = next(iter(results.values()))
    needed = own.bits_for(0.99)
    text = (
        f"{own.sentence(chip.bits).capitalize()}; "
        + (f"99 % of them need {needed} bits." if needed is not None else "no number of bits serves 99 % of them."),
        "This counts the converter alone: no offset, no noise, and this one chip. The other boundaries show what the "
        "same chip would need with open obstacles (neumann) or behind a resistance (wall).",
    )
    caption = "bits that every start needs (left), how many starts need how many, and how many a read-out serves"
    picture = Picture("adc_resolution", caption, results, {"bits": chip.bits})
    data = {"boundaries": {name: result.to_json() for name, result in results.items()}}
    return Section("adc_resolution", text, own.figures, (picture,), data)


def _by_boundary(chip: Study) -> dict[str, ADCResolution]:
    """The scene's own boundary first, then the others, on chips with the same flaws."""
    cells = chip.ideal.cells
    results: dict[str, ADCResolution] = {cells.wiring.boundary: chip.adc_resolution()}
    for boundary in ("dirichlet", "neumann", "wall"):
        walled = chip.chip is not None and chip.chip.wall_resistance is not None
        if boundary in results or (boundary == "wall" and not walled):
            continue
        try:
            other = study(cells.space, chip.chip, boundary=boundary, edge=cells.wiring.edge)
            results[boundary] = other.adc_resolution(span=chip.span)
        except CircuitError:  # nothing drives it that way
            continue
    return results


def settling_section(chip: Study, _effort: Effort) -> Section:
    """When every node has settled, and what a plan costs."""
    if not chip.netlist.capacitance.any():
        return _missing("settling", "the chip has no capacitance; give chip.capacitance, such as 50f")
    result = chip.usual_settling
    text = (
        f"Every node has settled to {result.bits} bits {formatted(result.settle_time, 's')} after the supplies are "
        f"switched on; a plan costs {formatted(result.energy, 'J')} until then.",
        *_linearised(chip),
    )
    curve = "the last node on its way to its final voltage"
    return _section(
        "settling",
        result,
        text,
        Picture("settling", "when each cell has settled", result),
        Picture("settling_curve", curve, result, {"quantity": "curve"}, is_map=False),
    )


def noise_section(chip: Study, _effort: Effort) -> Section:
    """How many steps of the converter the noise is."""
    bandwidth = None if chip.chip is None else chip.chip.readout.noise_bandwidth
    if bandwidth is None and not chip.netlist.capacitance.any():
        why = "neither the read-out's noise_bandwidth nor a capacitance limits it; give chip.readout.noise_bandwidth"
        return _missing("noise", why)
    result = chip.noise()
    assert result.total is not None
    assert result.band is not None
    worst, step = float(np.nanmax(result.total)), (chip.span or 1.0) / 2.0**chip.bits
    text = (
        f"The noisiest node has {formatted(worst, 'V')} rms in the band up to {formatted(result.band[1], 'Hz')}, "
        f"{worst / step:.2g} steps of a {chip.bits}-bit converter.",
        *_linearised(chip),
    )
    return _section("noise", result, text, Picture("noise", "rms noise of every cell in that band", result))


def _linearised(chip: Study) -> tuple[str, ...]:
    if not chip.netlist.nonlinear_nodes.size:
        return ()
    return ("The resistors saturate: this holds for small signals around the operating point.",)


def power_section(chip: Study, _effort: Effort) -> Section:
    """What the chip takes, and how far its rails droop."""
    result = chip.power()
    text = [f"The chip takes {formatted(result.total, 'W')} once it has settled."]
    pictures = [Picture("power", "heat by cell, and the hottest resistors", result)]
    if result.largest_droop > 0:
        text.append(
            f"Behind switches and rails, obstacle and goal cells lie up to {formatted(result.largest_droop, 'V')} off "
            "the voltage that they are tied to."
        )
        caption = "how far every obstacle and goal cell lies off the voltage that it is tied to"
        pictures.append(Picture("droop", caption, result, {"quantity": "droop"}))
    return _section("power", result, text, *pictures)


def sensitivity_section(chip: Study, _effort: Effort) -> Section:
    """Which resistors change a step when they drift."""
    result = chip.sensitivity()
    starts = 0 if chip.scene is None else len(chip.scene.starts)
    origin = {0: "the start that needs most bits", 1: "the start"}.get(starts, f"the {starts} starts")
    flips = len(result.flips(0.01))
    text = (
        f"On the way from {origin}, {flips or 'no'} resistor{'s' if flips != 1 else ''} can each alone change one of "
        "the robot's steps by drifting 1 %.",
        f"The {len(result.cells)} steps of the way lead to the lowest neighbour; a resistor changes one when it brings "
        "the runner-up level with it. A changed step is not yet a lost robot.",
    )
    caption = "resistors by the drift that changes a step"
    return _section("sensitivity", result, text, Picture("sensitivity", caption, result))


def sweep_section(chip: Study, effort: Effort) -> Section:
    """What yield two values of the chip give."""
    result = chip.sweep(
        *effort.sweep,
        trials=_EXPLORED,
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
    """How many starts single faults cost."""
    result = chip.faults(seconds=effort.seconds, progress=effort.progress)
    opened, shorted = (int((np.nan_to_num(result.lost(fault)) > 0).sum()) for fault in ("open", "short"))
    seen = "an ideal read-out" if result.ideal else f"the {result.bits}-bit converter without offset and noise"
    text = [
        f"Of {result.examined} resistors, switches and stretches of rail, {opened} cost at least one of the "
        f"{result.served} starts that are served when they are open, and {shorted} when they are shorted.",
        f"Each was made faulty alone, by an exact update of the solution, and all starts walked again; the robot sees "
        f"{seen}.",
        _worst(result),
    ]
    if result.examined < len(result.open):
        text.append(
            f"Time ran out after {result.examined} of {len(result.open)}, those with the largest currents (--seconds)."
        )
    pictures = (
        Picture(f"{fault}s", f"starts lost when an element is {what}", result, {"fault": fault})
        for fault, what in (("open", "open"), ("short", "shorted"))
    )
    return _section("defects", result, text, *pictures)


def _worst(result: FaultAnalysis) -> str:
    """Where the elements lie whose faults cost most."""
    words = []
    for fault in ("open", "short"):
        worst = result.worst(fault, 1)
        for (first, second), lost in zip(end_names(result.netlist, worst), result.lost(fault)[worst], strict=True):
            words.append(f"the worst {fault} is that between {first} and {second}, with {int(lost)} starts lost")
    return "; ".join(words).capitalize() + "." if words else "None costs a start."


SECTIONS: dict[str, Callable[[Study, Effort], Section]] = {
    "yield": yield_section,
    "yield_loss": yield_loss_section,
    "adc_resolution": adc_resolution_section,
    "settling": settling_section,
    "noise": noise_section,
    "power": power_section,
    "sensitivity": sensitivity_section,
    "sweep": sweep_section,
    "defects": defects_section,
}


def report_section(name: str, chip: Study, effort: Effort = USUAL) -> Section:
    """What one of the analyses says of a chip, without maps of spaces that have not two axes."""
    section = SECTIONS[name](chip, effort)
    is_plane = chip.ideal.cells.space.ndim == 2
    return replace(section, pictures=tuple(item for item in section.pictures if is_plane or not item.is_map))


def seconds_needed(name: str, chip: Study, effort: Effort) -> float:
    """Roughly how long an analysis takes."""
    nodes = chip.netlist.node_count
    known = {"settling": 1 + 2e-5 * nodes, "noise": 1 + 2e-4 * nodes, "sensitivity": 1 + 1e-4 * nodes, "yield": 2.0}
    return known.get(name, {"sweep": 5.0, "yield_loss": 3 + 6e-3 * nodes, "defects": effort.seconds}.get(name, 0.0))


def checkpoints_beside(folder: Path, chip: Study, sweep: Sequence[SweptKey]) -> dict[str, Path]:
    """Where the results of trials are kept until their folder is whole, by the analysis."""
    cells = chip.ideal.cells
    space, keys = cells.space, asdict(chip.chip or Chip())  # a repr would leave out the ends of long lists
    digest = hashlib.sha256(f"{keys} {cells.wiring} {sweep} {space.axes}".encode() + space.cell.tobytes())
    if space.conductivity is not None:
        digest.update(space.conductivity.tobytes())
    mark = digest.hexdigest()[:12]
    return {name: folder.parent / f".{folder.name}-{mark}.{name}.jsonl" for name in ("yield", "sweep")}


def report_markdown(chip: Study, parts: Sequence[Section], decks: Mapping[str, str], verdict: str) -> str:
    """The report: `decks` are files and what they are, `verdict` is what a simulator said of them."""
    lines = [f"# {chip.title}", "", *(f"- **{section.title}.** {section.text[0]}" for section in parts), ""]
    for section in parts:
        lines += [f"## {section.title}", "", " ".join(section.text), ""]
        if section.table:
            lines += [*section.table, ""]
        if section.figures:
            lines += [*figure_lines(section.figures), ""]
        lines += [f"![{picture.caption}]({picture.name}.png)\n\n*{picture.caption}*\n" for picture in section.pictures]
    lines += ["## Decks", "", _DECKS, "", verdict, "", *(f"- `{name}`: {what}" for name, what in decks.items()), ""]
    rows = ((f"`{key}`", value, meaning) for key, value, meaning in chip.parameters)
    return "\n".join([*lines, "## The chip", "", *table_lines(("key", "value", "meaning"), rows)]) + "\n"
