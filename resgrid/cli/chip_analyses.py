"""The analyses of a chip, one after the other, each with its pictures and what it says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from resgrid.cli.chip_parameters import written
from resgrid.cli.chip_report import Section, shown
from resgrid.cli.chip_study import Study
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.chip.criticality import Criticality
    from resgrid.chip.figures import Proportion
    from resgrid.chip.precision import Precision
    from resgrid.scene import Chip

_BITS = (6, 8, 10, 12, 14, 16)
_SHARES = (0.0, 0.01, 0.02, 0.05, 0.1)
_MULTIPLES = (0.0, 0.3, 1.0, 3.0, 10.0)
_EXPLORED = 32
_MOST_DECISIONS = 400
Pictures = dict[str, tuple[str, Any, dict[str, Any]]]
"""By name: what a picture shows, the function that draws it, and what that takes."""


def run_analysis(name: str, study: Study, made: Path, report: Report) -> Section:
    """Do one of the analyses, and draw its pictures into a folder."""
    return _BY_NAME[name](study, made, report)


def _power(study: Study, made: Path, report: Report) -> Section:
    from resgrid.chip.power import analyse_power

    with report.stage("power"):
        result = analyse_power(study.point)
    text = [f"The chip takes {shown(result.total, 'W')} once it has settled."]
    pictures = _draw(study, made, {"power": ("heat by cell, and the hottest resistors", result, {})})
    if result.largest_droop > 0:
        text.append(
            f"Behind switches and rails, obstacle and goal cells lie up to {shown(result.largest_droop, 'V')} off the "
            "voltage that they are tied to."
        )
        what = "how far every obstacle and goal cell lies off the voltage that it is tied to"
        pictures += _draw(study, made, {"droop": (what, result, {"quantity": "droop"})})
    return Section("power", "Power", tuple(text), result.readings, pictures, result.to_json())


def _settling(study: Study, made: Path, report: Report) -> Section:
    from resgrid.chip.settling import analyse_settling

    if not study.netlist.capacitance.any():
        return _missing("settling", "Settling", "the chip has no capacitance; give chip.capacitance, such as 50f")
    bits = min(study.bits, 24)
    with report.stage("settling", seconds=1 + 2e-5 * study.netlist.node_count):
        result = study.results["settling"] = analyse_settling(study.linear, bits=bits, span=study.span)
    text = (
        f"Every node has settled to {bits} bits {shown(result.settle_time, 's')} after the supplies are switched on; a "
        f"plan costs {shown(result.energy, 'J')} until then.",
        *_linearised(study),
    )
    wanted: Pictures = {
        "settling": ("when each cell has settled", result, {}),
        "settling_curve": ("the last node on its way to its final voltage", result, {"quantity": "curve"}),
    }
    return Section("settling", "Settling", text, result.readings, _draw(study, made, wanted), result.to_json())


def _noise(study: Study, made: Path, report: Report) -> Section:
    from resgrid.chip.decks import noise_band
    from resgrid.chip.noise import analyse_noise
    from resgrid.chip.settling import analyse_settling
    from resgrid.chip.trials import die_temperature

    bandwidth = study.chip.readout.noise_bandwidth
    with report.stage("noise", seconds=1 + 2e-4 * study.netlist.node_count):
        if bandwidth is None and not study.netlist.capacitance.any():
            why = (
                "neither the read-out's noise_bandwidth nor a capacitance limits it; give chip.readout.noise_bandwidth"
            )
            return _missing("noise", "Noise", why)
        if bandwidth is None:
            settling = study.results.get("settling") or analyse_settling(study.linear)
            band = (0.0, noise_band(settling)[1])
        else:
            band = (0.0, bandwidth)
        result = analyse_noise(study.linear, band=band, temperature=die_temperature(study.chip))
    assert result.total is not None
    worst, step = float(np.nanmax(result.total)), study.span / 2.0**study.bits
    text = (
        f"The noisiest node has {shown(worst, 'V')} rms in the band up to {shown(band[1], 'Hz')}, "
        f"{worst / step:.2g} steps of a {study.bits}-bit converter.",
        *_linearised(study),
    )
    pictures = _draw(study, made, {"noise": ("rms noise of every cell in that band", result, {})})
    return Section("noise", "Noise", text, result.readings, pictures, result.to_json())


def _sensitivity(study: Study, made: Path, report: Report) -> Section:
    from resgrid.chip.sensitivity import analyse_sensitivity

    cells = _decisions(study)
    with report.stage("sensitivity", seconds=1 + 1e-6 * len(cells) * study.netlist.node_count):
        result = analyse_sensitivity(study.point, cells)
    flips = len(result.flips(0.01))
    text = (
        f"On the way from {_origin(study)}, {flips or 'no'} resistor{'s' if flips != 1 else ''} can each alone change "
        "one of the robot's steps by drifting 1 %.",
        f"The {len(cells)} steps of the way lead to the lowest neighbour; a resistor changes one when it brings the "
        "runner-up level with it. A changed step is not yet a lost robot.",
    )
    wanted: Pictures = {"sensitivity": ("resistors by the drift that changes a step", result, {})}
    return Section("sensitivity", "Sensitivity", text, result.readings, _draw(study, made, wanted), result.to_json())


def _decisions(study: Study) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Cells on the ways from the scene's starts, or from the start that needs most bits."""
    from resgrid.planning.trace import start_cell

    precision, space = study.precision, study.job.space
    begins = [start_cell(space, start) for start in study.job.scene.starts]
    begins = [cell for cell in begins if space.goal_connected[cell]] or [_hardest(precision)]
    following, goal = precision.following.ravel(), space.cell.ravel() == 2
    passed: dict[int, None] = {}
    for begin in begins:
        cell = int(np.ravel_multi_index(begin, space.shape))
        while cell >= 0 and not goal[cell] and cell not in passed and following[cell] >= 0:
            passed[cell] = None
            cell = int(following[cell])
    if not passed:
        raise InputError("no start has a lower neighbour on this chip, so there is no step to examine")
    flat = np.array(list(passed)[:_MOST_DECISIONS])
    return np.stack(np.unravel_index(flat, space.shape), axis=1).astype(np.int64)


def _hardest(precision: Precision) -> tuple[int, ...]:
    finite = np.where(np.isfinite(precision.start_bits), precision.start_bits, -np.inf)
    return tuple(int(i) for i in np.unravel_index(int(np.argmax(finite)), finite.shape))


def _origin(study: Study) -> str:
    count = len(study.job.scene.starts)
    return {0: "the start that needs most bits", 1: "the start"}.get(count, f"the {count} starts")


def _precision(study: Study, made: Path, report: Report) -> Section:
    with report.stage("precision"):
        results = _by_boundary(study)
    own = next(iter(results.values()))
    needed = own.bits_for(0.99)
    text = [
        f"{own.sentence(study.bits).capitalize()}; "
        + (f"99 % of them need {needed} bits." if needed is not None else "no number of bits serves 99 % of them."),
        "This counts the converter alone: no offset, no noise, and this one chip. The other boundaries show what the "
        "same chip would need with open obstacles (neumann) or behind a resistance (wall).",
    ]
    pictures: tuple[tuple[str, str], ...] = ()
    if study.flat:
        from resgrid.plot import draw, save_figure

        save_figure(draw(results, bits=study.bits), made / "precision.png")
        what = "bits that every start needs (left), how many starts need how many, and how many a read-out serves"
        pictures = (("precision.png", what),)
    data = {"boundaries": {name: result.to_json() for name, result in results.items()}}
    return Section("precision", "Precision", tuple(text), own.readings, pictures, data)


def _by_boundary(study: Study) -> dict[str, Precision]:
    """The scene's own boundary first, then the others, on chips with the same flaws."""
    from resgrid.chip.build import build_chip, ideal_netlist
    from resgrid.chip.precision import analyse_precision
    from resgrid.errors import CircuitError
    from resgrid.nodal.solve import solve

    results = {study.boundary: study.precision}
    chip, edge = study.chip, study.job.scene.edge
    for boundary in ("dirichlet", "neumann", "wall"):
        if boundary in results or (boundary == "wall" and chip.wall_resistance is None):
            continue
        try:
            ideal = ideal_netlist(study.job.space, chip, boundary=boundary, edge=edge)
            results[boundary] = analyse_precision(solve(build_chip(ideal, chip)), span=study.span)
        except CircuitError:  # nothing drives it that way
            continue
    return results


def _yield(study: Study, made: Path, report: Report) -> Section:
    from resgrid.chip.yields import analyse_yield

    limits = study.limits
    with report.stage("yield", seconds=2.0) as progress, limits.workers() as executor:

        def tell(done: int, total: int, share: Proportion) -> None:
            progress.tell(done, total)
            progress.note(f"yield {100 * share.value:.1f} % ({100 * share.low:.1f} to {100 * share.high:.1f} %)")

        study.checkpoint.parent.mkdir(parents=True, exist_ok=True)
        result = study.results["yield"] = analyse_yield(
            study.ideal, study.chip, half_width=limits.half_width, most=limits.most, executor=executor,
            checkpoint=study.checkpoint, progress=tell,
        )  # fmt: skip
    overall = result.overall
    known = f" ({100 * overall.low:.1f} to {100 * overall.high:.1f} %)" if result.random else ""
    text = (
        f"A robot that sees only the read-out reaches a goal from {100 * overall.value:.4g} % of the starts{known}; "
        f"{100 * result.perfect.value:.4g} % of the chips serve every start.",
        "In each cell it measures its own node and those of the free neighbours, and steps to the lowest reading if "
        "that is strictly lower than its own; stuck, or back where it has been, it is lost.",
        _tried(study, result.trials, random=result.random),
    )
    pictures = _draw(study, made, {"yield": ("chips on which each start is served", result, {})})
    return Section("yield", "Yield", text, result.readings, pictures, result.to_json())


def _tried(study: Study, trials: int, *, random: bool) -> str:
    if not random:
        return "Nothing about this chip is random, so one chip says it all."
    return f"{trials} chips of seed {study.chip.seed} were tried; intervals are those of Wilson at 95 %."


def _exploration(study: Study, made: Path, report: Report) -> Section:
    from resgrid.chip.exploration import explore_yield

    first, second = study.limits.sweep or _usual_sweep(study.chip)
    with report.stage("exploration", seconds=5.0) as progress, study.limits.workers() as executor:
        result = explore_yield(
            study.job.space, study.chip, first, second, **study.options, trials=_EXPLORED, executor=executor,
            progress=lambda done, total, _share: progress.tell(done, total),
        )  # fmt: skip
    least = result.cheapest(0.99)
    told = ", ".join(
        f"{_told(first[0], value)}: {'none tried' if bits is None else _told(second[0], bits)}"
        for value, bits in zip(result.first_values, least, strict=True)
    )
    text = (
        f"The least `{result.second}` that serves 99 % of the starts, by `{result.first}`: {told}.",
        f"{result.trials} chips at every point, the same dies throughout.",
    )
    pictures = _draw(study, made, {"exploration": ("yield over two values of the chip", result, {})}, always=True)
    return Section("exploration", "Exploration", text, result.readings, pictures, result.to_json())


def _usual_sweep(chip: Chip) -> tuple[tuple[str, tuple[float, ...]], tuple[str, tuple[int, ...]]]:
    if chip.readout.offset:
        offset = chip.readout.offset
        return ("readout.offset", tuple(float(f"{offset * k:.3g}") for k in _MULTIPLES)), ("readout.bits", _BITS)
    if chip.pelgrom:
        return ("pelgrom", tuple(float(f"{chip.pelgrom * k:.3g}") for k in _MULTIPLES)), ("readout.bits", _BITS)
    return ("mismatch", _SHARES), ("readout.bits", _BITS)


def _defects(study: Study, made: Path, report: Report) -> Section:
    from resgrid.chip.criticality import analyse_criticality

    with report.stage("defects", seconds=study.limits.seconds) as progress:
        result = analyse_criticality(
            study.netlist, study.chip.readout, short_resistance=study.chip.defects.short_resistance,
            seconds=study.limits.seconds, progress=progress.tell,
        )  # fmt: skip
    opened, shorted = (int((np.nan_to_num(lost) > 0).sum()) for lost in (result.open, result.short))
    text = (
        f"Of {result.examined} resistors, switches and stretches of rail, {opened} cost at least one of the "
        f"{result.served} starts that are served when they are open, and {shorted} when they are shorted.",
        "Each was made faulty alone, by an exact update of the solution, and all starts walked again; the robot sees "
        f"{'an ideal read-out' if result.ideal else f'the {result.bits}-bit converter without offset and noise'}.",
        _worst(result),
        *(() if result.examined == len(result.open) else (f"Time ran out after {result.examined} of "
          f"{len(result.open)}, those with the largest currents (--seconds).",)),
    )  # fmt: skip
    wanted: Pictures = {
        "opens": ("starts lost when an element is open", result, {"fault": "open"}),
        "shorts": ("starts lost when an element is shorted", result, {"fault": "short"}),
    }
    return Section("defects", "Defects", text, result.readings, _draw(study, made, wanted), result.to_json())


def _told(key: str, value: Any) -> str:
    from resgrid.scene import Chip
    from resgrid.scene.table import described_keys

    return written(value, described_keys(Chip)[key][0])


def _worst(result: Criticality) -> str:
    """Where the elements lie whose faults cost most."""
    netlist = result.netlist
    ends = np.concatenate([netlist.resistor_nodes, netlist.nonlinear_nodes])
    words = []
    for fault in ("open", "short"):
        for element in result.worst(fault, 1).tolist():
            first, second = netlist.names_of(ends[element])
            lost = int((result.open if fault == "open" else result.short)[element])
            words.append(f"the worst {fault} is that between {first} and {second}, with {lost} starts lost")
    return "; ".join(words).capitalize() + "." if words else "None costs a start."


def _linearised(study: Study) -> tuple[str, ...]:
    if not study.netlist.nonlinear_nodes.size:
        return ()
    return ("The resistors saturate: this holds for small signals around the operating point.",)


def _missing(name: str, title: str, why: str) -> Section:
    return Section(name, title, (f"Not analysed: {why}.",), data={"reason": why})


def _draw(study: Study, made: Path, wanted: Pictures, *, always: bool = False) -> tuple[tuple[str, str], ...]:
    """Draw pictures, by name: what it shows, the result, and options.  Maps need two axes."""
    from resgrid.plot import draw, save_figure

    pictures = []
    for name, (what, result, options) in wanted.items():
        if study.flat or always or options.get("quantity") == "curve":
            save_figure(draw(result, **options), made / f"{name}.png")
            pictures.append((f"{name}.png", what))
    return tuple(pictures)


Analysis = Callable[[Study, Path, Report], Section]

_BY_NAME: dict[str, Analysis] = {
    "yield": _yield,
    "precision": _precision,
    "settling": _settling,
    "noise": _noise,
    "power": _power,
    "sensitivity": _sensitivity,
    "exploration": _exploration,
    "defects": _defects,
}
