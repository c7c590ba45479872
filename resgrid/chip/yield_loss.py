"""Causes of yield loss: the yield with each effect of a chip switched off in turn, and limits of three errors.

The limits are the largest mismatch, the largest offset and the fewest bits with which the yield reaches a target.
All chips share their random numbers (common random numbers): trial ``k`` is the same chip with and without an effect,
so that the difference of two yields has a much smaller variance than each yield.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.build import chip_keys, chip_with
from resgrid.chip.error_limits import Ladder, Limit, bits_ladder, find_limit, mismatch_ladder, offset_ladder
from resgrid.chip.figures_of_merit import Figure, Proportion, Result, table_lines
from resgrid.chip.monte_carlo import Noises
from resgrid.chip.paired_trials import StartsServed, groups_of, run_groups
from resgrid.chip.yields import Progress, overall_yield
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import CircuitError, InputError
from resgrid.scene.chip import Chip

EFFECTS: dict[str, dict[str, Any]] = {
    "mismatch": {"mismatch": None, "pelgrom": None},
    "gradient": {"gradient": None},
    "preferred values": {"preferred": None},
    "drawn lengths": {"sheet_resistance": None},
    "temperature": {"temperature": None},
    "saturation": {"saturation_voltage": None},
    "rail switches": {f"{rail}_switch_{state}": None for rail in ("goal", "obstacle") for state in ("on", "off")},
    "internodal switches": {f"internodal_switch_{state}": None for state in ("on", "off")},
    "rail resistance": {"rail_resistance": None},
    "defects": {"defects.open_density": 0.0, "defects.short_density": 0.0, "defects.open_at": ()},
    "read-out load": {"readout.input_resistance": None},
    "offset": {"readout.offset": None},
    "noise": {"readout.noise_bandwidth": None},
    "quantization": {"readout.bits": None, "readout.range": None},
}
"""Effects of a chip by name.  Each value maps the keys of the chip description that cause the effect to their values
without it.
"""

_MOST_TRIALS, _LEAST_TRIALS, _CELLS = 400, 16, 2**18
"""Default number of chips: maximum, minimum, and approximate number of cells of all chips together (262,144).

The number of chips is the third value divided by the number of cells of a chip, within the two limits.
At least 381 chips without a failure are needed for a Wilson interval at 95 % that lies above 99 %.
"""
_BISECTED = 10
"""Number of mismatches that a bisection is expected to try; used for the total number of trials in the progress report.
"""


@dataclass(frozen=True)
class Cause:
    """One effect of a chip, and the yield without it.

    An entry of `YieldLoss.causes`, which `resgrid.chip.Study.yield_loss` returns.

    Attributes
    ----------
    name : str
        Name of the effect.
    keys : tuple of str
        Keys of the chip description that cause the effect.
    share : Proportion
        Yield without the effect.
    gain : float
        Change of the yield (a fraction) by switching the effect off; positive where the effect costs yield.
    low, high : float
        Ends of the confidence interval of the gain, from the differences chip by chip.
    changed : int
        Number of chips on which the number of starts that reach a goal changes when the effect is switched off.

    Examples
    --------
    >>> chip = rg.Chip(mismatch=0.02, readout=rg.chip.Readout(bits=8))
    >>> loss = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip).yield_loss(trials=16)
    >>> for cause in loss.causes:
    ...     print(f"{cause.name} ({', '.join(cause.keys)}) costs {100 * cause.gain:.0f} % of the starts")
    quantization (readout.bits) costs 29 % of the starts
    mismatch (mismatch) costs 1 % of the starts
    """

    name: str
    keys: tuple[str, ...]
    share: Proportion
    gain: float
    low: float
    high: float
    changed: int


@dataclass(frozen=True, eq=False, repr=False)
class YieldLoss(Result):
    """Causes of yield loss: the yield without each effect of a chip, and limits of three errors.

    Returned by `resgrid.chip.Study.yield_loss`.

    Attributes
    ----------
    overall : Proportion
        Yield of the chip as described, with its interval.
    causes : tuple of Cause
        Every effect of the chip, largest gain first.
    limits : tuple of Limit
        The largest mismatch, the largest offset and the fewest bits with which the yield reaches the target.
    target : float
        Yield that the limits reach, as a fraction.
    trials : int
        Number of chips for each variant of the description; trial ``k`` has the same random numbers in each variant.
    confidence : float
        Confidence of the intervals, between 0 and 1.
    figures : mapping of str to Figure
        The yield and the limits by name.

    Examples
    --------
    >>> chip = rg.Chip(mismatch=0.02, readout=rg.chip.Readout(bits=8))
    >>> loss = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip).yield_loss(trials=16)
    >>> print(loss.overall)
    70.6 % (67.6 to 73.5 %)
    >>> [(cause.name, round(cause.gain, 2)) for cause in loss.causes]
    [('quantization', 0.29), ('mismatch', 0.01)]
    >>> loss.figures["fewest_bits"].value
    11
    """

    overall: Proportion
    causes: tuple[Cause, ...]
    limits: tuple[Limit, ...]
    target: float
    trials: int
    confidence: float

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name: the overall yield (``yield``), and the figure of every limit by the limit's name.

        Names of limits: ``largest_mismatch``, ``largest_offset`` and ``fewest_bits``.
        """
        text = f"fraction of all starts that reach a goal, averaged over {self.trials} chips with all effects"
        figures = {"yield": Figure(self.overall.value, "", text)}
        return figures | {limit.name: limit.figure for limit in self.limits}

    def to_json(self) -> dict[str, Any]:
        """Return the result as a dictionary for JSON.

        Keys: the names of `figures`, each with a dictionary of ``value``, ``unit`` and ``definition``; ``causes`` and
        ``limits``: lists of dictionaries with the fields of `Cause` and `Limit`; ``target``: yield to reach;
        ``trials``: number of chips per variant; ``confidence``: confidence of the intervals.
        """
        return {
            **super().to_json(),
            "causes": [asdict(cause) for cause in self.causes],
            "limits": [asdict(limit) for limit in self.limits],
            "target": self.target,
            "trials": self.trials,
            "confidence": self.confidence,
        }


def analyse_yield_loss(
    netlist: Netlist,
    chip: Chip,
    *,
    target: float = 0.99,
    trials: int | None = None,
    confidence: float = 0.95,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> YieldLoss:
    """Estimate the yield without each effect of a chip, and the limits of three errors; return them as a YieldLoss.

    The limits are the largest mismatch, the largest offset and the fewest bits with which the yield reaches `target`,
    each with all other values of the chip unchanged.

    `netlist`: ideal circuit, compiled from a space; `chip`: chip description; `target`: yield to reach, a fraction;
    `trials`: number of chips for each variant of the description, None for 16 to 400, fewer for spaces with more cells;
    `confidence`: confidence of the intervals, between 0 and 1;
    `executor`: workers, None for this process; `progress`: function called after each variant, with the number of
    finished trials, the expected number, and the yield of the variant.
    """
    space, chip = netlist.cells.space, chip.with_process()
    starts = int(space.goal_connected.sum())
    count = trials or usual_trials(space)
    offsets, bits, mismatches = offset_ladder(chip), bits_ladder(chip), mismatch_ladder(chip)
    removed = _without(chip)
    points = {("", 0): chip} | {(name, 0): other for name, (_, other) in removed.items()}
    for ladder in (offsets, bits):
        points |= {(ladder.name, candidate): ladder.chip_with(value) for candidate, value in enumerate(ladder.values)}
    known: Noises = {}  # mismatch does not change the noise without random errors
    groups = groups_of(netlist, points, count, known)
    served: dict[tuple[str, int], StartsServed] = {}
    done, expected = 0, (len(groups) + _BISECTED) * count

    def report(share: Proportion) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, max(expected, done), share)

    def share_of(result: StartsServed) -> Proportion:
        return overall_yield(result.counts, starts, confidence, random=result.random)

    for group in groups:
        try:
            (results,) = run_groups([group], starts, executor)
        except CircuitError:
            if ("", 0) in group.keys:
                raise
            continue  # without this effect, the chip has no operating point
        served |= results
        report(share_of(next(iter(results.values()))))

    def yield_at_mismatch(candidate: int) -> Proportion:
        if candidate == 0 and ("mismatch", 0) in served:
            return share_of(served["mismatch", 0])
        point = {candidate: mismatches.chip_with(mismatches.values[candidate])}
        (group,) = run_groups(groups_of(netlist, point, count, known), starts, executor)
        report(share_of(group[candidate]))
        return share_of(group[candidate])

    def limit_of(ladder: Ladder) -> Limit:
        return find_limit(ladder, target, lambda candidate: share_of(served[ladder.name, candidate]), every=True)

    base = served["", 0]
    causes = [
        _cause(name, keys, base, served[name, 0], share_of(served[name, 0]), (starts, count))
        for name, (keys, _) in removed.items()
        if (name, 0) in served
    ]
    causes.sort(key=lambda cause: -cause.gain)
    limits = (find_limit(mismatches, target, yield_at_mismatch, every=False), limit_of(offsets), limit_of(bits))
    return YieldLoss(share_of(base), tuple(causes), limits, target, count, confidence)


def usual_trials(space: ConfigurationSpace) -> int:
    """Return the default number of chips for each variant of a description: 16 to 400, fewer for more cells."""
    return min(_MOST_TRIALS, max(_LEAST_TRIALS, _CELLS // space.cell.size))


def _without(chip: Chip) -> dict[str, tuple[tuple[str, ...], Chip]]:
    """Return the effects of a chip by name: the keys that cause an effect, and the chip description without it.

    A key is a key of the chip description, such as ``readout.bits``.  An effect is left out if its keys are unset or 0,
    or if the description would be invalid without its keys.
    """
    values = chip_keys(chip)
    found = {}
    for name, ideal in EFFECTS.items():
        keys = tuple(key for key, value in ideal.items() if values[key] and values[key] != value)
        if not keys:
            continue
        try:
            found[name] = keys, chip_with(chip, {key: ideal[key] for key in keys})
        except InputError:  # another key needs one of these
            continue
    return found


def _cause(
    name: str, keys: tuple[str, ...], base: StartsServed, other: StartsServed, share: Proportion, size: tuple[int, int]
) -> Cause:
    """Return the change of the yield by switching one effect off, compared chip by chip, as a Cause.

    `name`: name of the effect; `keys`: keys of the chip description that cause it; `base`: numbers of starts from which
    the robot reaches a goal, on the chips with all effects; `other`: these numbers without this effect; `share`: yield
    without the effect; `size`: number of starts and number of chips.
    """
    starts, trials = size
    differences = (other.counts - base.counts) / starts  # without randomness, one chip stands for all
    changed, mean = int(np.count_nonzero(differences)), float(differences.mean())
    if not (base.random or other.random):
        return Cause(name, keys, share, mean, mean, mean, changed * trials)
    return Cause(name, keys, share, mean, *paired_interval(differences, share.confidence), changed)


def paired_interval(differences: NDArray[np.float64], confidence: float) -> tuple[float, float]:
    """Return the lower and upper ends of the confidence interval of a mean of paired differences.

    It is Student's t interval.  If all ``n`` differences are 0, the ends are ``-b`` and ``b``, with ``b = 1 - (1 -
    confidence)**(1/n)``: with this confidence, at most a fraction ``b`` of all chips differs.  If there is only one
    trial and its difference is not 0, the ends are -1 and 1.  `differences` (trials,): numbers between -1 and 1;
    `confidence`: between 0 and 1.
    """
    from scipy.special import stdtrit

    trials, mean = len(differences), float(differences.mean())
    if not differences.any():
        bound = 1.0 - (1.0 - confidence) ** (1.0 / trials)
        return -bound, bound
    if trials < 2:
        return -1.0, 1.0
    half = float(stdtrit(trials - 1, 0.5 + 0.5 * confidence) * differences.std(ddof=1) / np.sqrt(trials))
    return max(mean - half, -1.0), min(mean + half, 1.0)


def loss_sentences(result: YieldLoss) -> tuple[str, ...]:
    """Return sentences on the causes of yield loss, the largest loss first."""
    mismatch = (cause for cause in result.causes if cause.name == "mismatch")
    return (
        _largest_loss(result),
        *(f"Without its mismatch, the yield would change by {_change(cause)} percentage points." for cause in mismatch),
        *(f"{_LIMITS[limit.name]} for {100 * limit.target:.4g} %: {limit.answer}." for limit in result.limits),
        f"Each effect was switched off separately on the same {result.trials} dies, with the same offsets and noise "
        f"otherwise; the intervals of the changes are those of paired differences at {100 * result.confidence:.4g} %. "
        "Effects interact, so that changes do not add up.",
    )


def loss_table(result: YieldLoss) -> tuple[str, ...]:
    """Return the lines of a Markdown table of the causes of yield loss, one row for every effect of the chip.

    The columns are the effect that is switched off, the yield without this effect but with all others, its difference
    from the yield with all effects, and the number of chips on which the number of starts that reach a goal changes.
    """
    rows = (
        (
            f"{cause.name} ({', '.join(f'`{key}`' for key in cause.keys)})",
            f"{100 * cause.share.value:.1f} %",
            _change(cause),
            f"{cause.changed}",
        )
        for cause in result.causes
    )
    return tuple(
        table_lines(("switched off", "yield", "change, in points", f"chips changed, of {result.trials}"), rows)
    )


_LIMITS = {
    "largest_mismatch": "Largest mismatch",
    "largest_offset": "Largest offset",
    "fewest_bits": "Fewest bits",
}
"""First words of the sentence on each error limit, by the name of the limit."""


def _largest_loss(result: YieldLoss) -> str:
    """Return a sentence on the yield and on up to three effects whose removal certainly raises the yield.

    The largest change comes first.  A change is certain if its confidence interval is above 0.
    """
    now = f"{100 * result.overall.value:.1f} %"
    losses = [cause for cause in result.causes if cause.low > 0]
    if not losses:
        return f"The yield is {now}; no single effect has a significant cost."
    first, *others = (f"{cause.name} ({_points(cause.gain)} points)" for cause in losses[:3])
    also = f", then {' and '.join(others)}" if others else ""
    return f"The yield is {now}; the largest gains come from removing {first}{also}."


def _change(cause: Cause) -> str:
    """Return the change of the yield by a cause with its interval, in percentage points, as text."""
    if not cause.changed:
        return "0.00 (no chip changes)"
    return f"{_points(cause.gain)} ({_points(cause.low)} to {_points(cause.high)})"


def _points(share: float) -> str:
    """Return a change of a yield, given as a fraction, as signed text in percentage points; ``"0.00"`` for zero."""
    text = f"{100 * share:+.2f}"
    return "0.00" if float(text) == 0 else text
