"""Error limits of a chip: the largest value of one error at which the yield still reaches a target.

The candidate values of an error form a ladder from ideal to worst, in steps of the E12 series (IEC 60063) or of one
bit. The yields of all values come from the same chips and the same random numbers (common random numbers), so that
neighbouring values differ by the error only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from resgrid.chip.figures_of_merit import Figure, Proportion, formatted
from resgrid.scene.chip import Chip

_E12 = (1.0, 1.2, 1.5, 1.8, 2.2, 2.7, 3.3, 3.9, 4.7, 5.6, 6.8, 8.2)
"""Preferred values of the E12 series between 1 and 10."""
_MOST_BITS = 32
"""Largest converter resolution that is tried, in bits."""
_SMALLEST_OFFSET = 1e-6
"""Smallest nonzero standard deviation of the read-out's offset that is tried, as a fraction of the supply."""


@dataclass(frozen=True)
class Limit:
    """The worst value of one error at which the yield still reaches a target, with all other values unchanged.

    An entry of `YieldLoss.limits`, which `resgrid.chip.Study.yield_loss` returns.

    Attributes
    ----------
    name : str
        ``"largest_mismatch"`` (standard deviation of a resistance over its mean), ``"largest_offset"`` (V) or
        ``"fewest_bits"``.
    target : float
        The yield to reach.
    value : float, int or None
        The worst candidate at which, and at all better ones, the yield reaches the target.  None where the yield at
        the ideal value misses the target, or where only an ideal converter reaches it.
    share : Proportion
        Yield at `value`, or at the ideal value where `value` is None.
    beyond : float, int or None
        The next worse candidate after `value`; None if `value` is the last candidate, and where the yield at the ideal
        value misses the target.
    beyond_share : Proportion or None
        Yield at `beyond`, below the target; None if there is no next candidate.
    sure, possible : float, int or None
        Ends of the interval of `value`.  `sure`: the worst value, not beyond `value`, at which the lower end of the
        yield's confidence interval reaches the target; `possible`: the worst value at which the upper end does.  None
        where only an ideal converter, or no value at all, has such a yield.
    reached : bool
        Whether the yield reaches the target at the ideal value.
    tolerated : float, int or None
        Only where the yield at the ideal value misses the target: the worst value at which the yield is at most ``1 -
        target`` below that of the ideal value.  Otherwise None.
    tried : tuple of (float, int or None, Proportion)
        Every candidate that was tried, best first, with its yield; None is an ideal converter.
    figure : Figure
        The value with its unit and definition.
    answer : str
        The value as text, with the yields at this value and at the next worse one.
    remark : str
        The yields at the limit and at the next worse candidate, or the reason why there is no limit.

    Examples
    --------
    >>> chip = rg.Chip(mismatch=0.02, readout=rg.chip.Readout(bits=8))
    >>> loss = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip).yield_loss(trials=16)
    >>> limit = loss.limits[2]
    >>> limit.name, limit.value, limit.beyond
    ('fewest_bits', 11, 10)
    >>> limit.answer
    '11 bits, where the yield is 100.0 % (at 10 bits it is 94.0 %)'
    """

    name: str
    target: float
    value: float | int | None
    share: Proportion
    beyond: float | int | None
    beyond_share: Proportion | None
    sure: float | int | None
    possible: float | int | None
    reached: bool
    tolerated: float | int | None = None
    tried: tuple[tuple[float | int | None, Proportion], ...] = field(repr=False, default=())

    @property
    def figure(self) -> Figure:
        """The value of the limit with its unit and definition, as a Figure."""
        definition, unit = _WORDS[self.name]
        ends = [self.sure, self.possible] if self.name != "fewest_bits" else [self.possible, self.sure]
        shown = " to ".join("not reached" if end is None else self._text(end) for end in ends)
        text = f"{definition} at which the yield still reaches {100 * self.target:.4g} %, all else unchanged"
        return Figure(self.value, unit, f"{text}; {self.remark} ({self.share.confidence:.0%} interval: {shown})")

    @property
    def answer(self) -> str:
        """The value of the limit as text, with the yields at this value and at the next worse one."""
        if not self.reached:
            return self.remark
        return f"{_IDEAL[self.name] if self.value is None else self._text(self.value)}, {self.remark}"

    @property
    def remark(self) -> str:
        """The yields at the limit and at the next worse candidate, or the reason why there is no limit, as text."""
        if not self.reached:
            text = f"not reached even with {_IDEAL[self.name]}, where the yield is {self.share}: other causes dominate"
            if self.tolerated is None:
                return text
            cost = f"{100 * (1 - self.target):.3g} percentage point{'s' * (self.target < 0.99)}"
            return f"{text}; {self._text(self.tolerated)} would cost at most {cost} more"
        if self.beyond is None or self.beyond_share is None:
            return f"where the yield is {self.share}; no worse value was tried"
        here, next_one = _distinguished(self.share.value, self.beyond_share.value)
        return f"where the yield is {here} (at {self._text(self.beyond)} it is {next_one})"

    def _text(self, value: float) -> str:
        """Return a value of the limited error as text with its unit, such as ``"11 bits"``."""
        if self.name == "fewest_bits":
            return f"{value} bit{'s' * (value != 1)}"
        return f"{100 * value:.3g} %" if self.name == "largest_mismatch" else formatted(value, _WORDS[self.name][1])


def _distinguished(first: float, second: float) -> tuple[str, str]:
    """Return two fractions as texts in per cent, with the fewest decimals (one to five) that make the texts differ.

    `first, second`: the fractions, between 0 and 1.  If no number of decimals makes them differ, both have five.
    """
    for decimals in range(1, 6):
        texts = f"{100 * first:.{decimals}f} %", f"{100 * second:.{decimals}f} %"
        if texts[0] != texts[1]:
            break
    return texts


_WORDS = {
    "largest_mismatch": ("largest standard deviation of a resistance, as a fraction of its mean,", ""),
    "largest_offset": ("largest standard deviation of the read-out's offset", "V"),
    "fewest_bits": ("fewest bits of the converter", "bit"),
}
"""Definition and unit of each limit, by the name of the limit."""
_IDEAL = {
    "largest_mismatch": "zero mismatch",
    "largest_offset": "zero offset",
    "fewest_bits": "an ideal converter",
}
"""Text for the ideal value of each limit, by the name of the limit."""


@dataclass(frozen=True)
class Ladder:
    """Candidate values of one error, from ideal to worst.

    `name`: name of the limit, such as ``"fewest_bits"``; `values`: candidates, None for an ideal converter;
    `chip_with`: function from a candidate to the chip description with this value of the error.
    """

    name: str
    values: tuple[float | int | None, ...]
    chip_with: Callable[[Any], Chip]


def mismatch_ladder(chip: Chip) -> Ladder:
    """Return the Ladder of the mismatches to try for a chip: 0, and 0.01 % to 82 % in steps of the E12 series.

    A mismatch is the standard deviation of a resistance over its mean.  If the description has a Pelgrom coefficient
    and the area of a resistor, a candidate changes the coefficient and keeps the area.
    """

    def changed(deviation: float) -> Chip:
        area = _area(chip)
        if chip.pelgrom is None or area is None:
            return dataclasses.replace(chip, mismatch=deviation, pelgrom=None)
        return dataclasses.replace(chip, pelgrom=100.0 * deviation * area**0.5 * 1e6)

    values = (float(f"{mantissa}e{power}") for power in (-4, -3, -2, -1) for mantissa in _E12)
    return Ladder("largest_mismatch", (0.0, *values), changed)


def _area(chip: Chip) -> float | None:
    """Return the area of the strip of a resistor of nominal value, in square metres.

    The result is None if the chip description `chip` lacks the width, or both the length and the sheet resistance.
    """
    if chip.width is None:
        return None
    length = chip.length
    if chip.sheet_resistance is not None:
        length = chip.width * chip.resistance / chip.sheet_resistance
    return None if length is None else chip.width * length


def offset_ladder(chip: Chip) -> Ladder:
    """Return the Ladder of the read-out offsets to try for a chip, as standard deviations in volts.

    The candidates are 0, and the E12 values from a millionth of the supply voltage to the supply voltage.
    """
    supply = abs(chip.supply)
    every = (float(f"{mantissa}e{power}") for power in range(-18, 13) for mantissa in _E12)
    values = (value for value in every if _SMALLEST_OFFSET * supply <= value <= supply)

    def changed(offset: float) -> Chip:
        return dataclasses.replace(chip, readout=dataclasses.replace(chip.readout, offset=offset))

    return Ladder("largest_offset", (0.0, *values), changed)


def bits_ladder(chip: Chip) -> Ladder:
    """Return the Ladder of the converter resolutions to try for a chip: an ideal converter, and 32 bits down to 1."""

    def changed(bits: int | None) -> Chip:
        return dataclasses.replace(chip, readout=dataclasses.replace(chip.readout, bits=bits))

    return Ladder("fewest_bits", (None, *range(_MOST_BITS, 0, -1)), changed)


def find_limit(ladder: Ladder, target: float, yields: Callable[[int], Proportion], *, every: bool) -> Limit:
    """Find the worst value of an error at which the yield still reaches a target; return it as a Limit.

    `ladder`: candidate values; `target`: yield to reach, between 0 and 1; `yields`: function from the position of a
    candidate in `ladder.values` to its yield; `every`: whether to try the candidates one after the other; otherwise
    bisect, assuming that the yield falls from candidate to candidate.
    """
    count = len(ladder.values)
    seen: dict[int, Proportion] = {}

    def at(candidate: int) -> Proportion:
        if candidate not in seen:
            seen[candidate] = yields(candidate)
        return seen[candidate]

    search = _last_by_scan if every else _last_by_bisection
    last = search(count, lambda candidate: at(candidate).value >= target)
    sure = _last_sure(last, lambda candidate: at(candidate).low >= target, every=every)
    possible = search(count, lambda candidate: at(candidate).high >= target)
    near = -1 if last >= 0 else search(count, lambda candidate: at(candidate).value >= at(0).value - (1.0 - target))
    beyond = last + 1 if 0 <= last < count - 1 else None
    values = ladder.values
    return Limit(
        ladder.name,
        target,
        values[last] if last >= 0 else None,
        at(max(last, 0)),
        None if beyond is None else values[beyond],
        None if beyond is None else at(beyond),
        values[sure] if sure >= 0 else None,
        values[possible] if possible >= 0 else None,
        last >= 0,
        values[near] if near > 0 else None,
        tuple((values[candidate], seen[candidate]) for candidate in sorted(seen)),
    )


def _last_by_scan(count: int, passes: Callable[[int], bool]) -> int:
    """Return the position of the last candidate before the first one that fails; -1 if candidate 0 fails.

    `count`: number of candidates; `passes`: function from the position of a candidate to whether it is sufficient.
    """
    return next((candidate for candidate in range(count) if not passes(candidate)), count) - 1


def _last_sure(last: int, passes: Callable[[int], bool], *, every: bool) -> int:
    """Return the position of the worst candidate, up to `last`, whose whole confidence interval passes; -1 for none.

    A better candidate (an earlier position) may fail although a worse one passes: the confidence interval is wider
    where all chips serve equally many starts than where the numbers differ a little.  `last`: position of the last
    candidate to consider, -1 for none; `passes`: function from the position of a candidate to whether the lower end of
    its interval reaches the target; `every`: True to try all candidates from `last` backwards, False to bisect.
    """
    if every:
        return next((candidate for candidate in range(last, -1, -1) if passes(candidate)), -1)
    candidate = _last_by_bisection(last + 1, lambda candidate: candidate == 0 or passes(candidate)) if last >= 0 else -1
    return candidate if candidate >= 0 and passes(candidate) else -1


def _last_by_bisection(count: int, passes: Callable[[int], bool]) -> int:
    """Return the position of a candidate that passes and whose successor fails; -1 if candidate 0 fails.

    If no candidate fails, the position of the last is returned.  `count`: number of candidates; `passes`: function from
    the position of a candidate to whether it is sufficient.
    """
    if not passes(0):
        return -1
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low
