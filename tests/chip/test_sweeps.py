"""Sweeps over two keys of a chip, against yields computed point by point.

Tests internals: `resgrid.chip.build`.
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.chip.build import chip_with


def walled_space() -> rg.ConfigurationSpace:
    cell = np.zeros((10, 10), dtype=np.uint8)
    cell[3:7, 4] = 1
    cell[1, 1] = 2
    return space_of(cell)


CHIP = rg.Chip(mismatch=0.05, goal_switch_on=100.0, readout=rg.chip.Readout(offset=1e-3), seed=5)


@pytest.mark.parametrize("order", [1, -1])
def test_keys_of_one_table_are_changed_together(order: int) -> None:
    """If the keys were changed one after the other, the sum of both densities would exceed 1 in between."""
    before = rg.Chip(defects=rg.chip.Defects(open_density=0.7, short_density=0.2))
    values = {"defects.open_density": 0.2, "defects.short_density": 0.7}
    after = chip_with(before, dict([*values.items()][::order]))
    assert after == rg.Chip(defects=rg.chip.Defects(open_density=0.2, short_density=0.7))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (("mismatch", [0.0, 0.1]), ("readout.bits", [4, 8, 12])),
        (("resistance", [1e3, 1e5]), ("readout.offset", [0.0, 0.01])),
        (("boundary-free supply", [1.0]), ("readout.bits", [8])),
    ],
)
def test_every_point_of_a_sweep_equals_the_yield_of_its_chip(
    first: tuple[str, list[float]], second: tuple[str, list[float]]
) -> None:
    if " " in first[0]:
        with pytest.raises(rg.InputError, match="a chip has no key"):
            rg.study(walled_space(), CHIP).sweep(first, second)
        return
    reports = []
    result = rg.study(walled_space(), CHIP).sweep(first, second, trials=12, progress=lambda *all: reports.append(all))
    assert reports[-1][0] == reports[-1][1] == result.share.size * 12
    for (i, j), share in np.ndenumerate(result.share):
        chip = chip_with(CHIP, {first[0]: first[1][i], second[0]: second[1][j]})
        alone = rg.study(walled_space(), chip).yields(trials=12, batch=12)
        assert share == alone.overall.value
        assert (result.low[i, j], result.high[i, j]) == (alone.overall.low, alone.overall.high)


def test_a_sweep_resumes_from_a_truncated_checkpoint_and_rejects_damaged_ones(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    axes = ("mismatch", [0.0, 0.1, 0.2]), ("readout.bits", [6, 10])
    kind = dataclasses.replace(CHIP, readout=rg.chip.Readout())

    def explored(**options: Any) -> rg.chip.Sweep:
        return rg.study(walled_space(), kind).sweep(*axes, trials=12, **options)

    alone = explored(checkpoint=file)
    data = file.read_bytes()
    assert data.count(b"\n") == 1 + 1 + 12 + 12  # chips without mismatch are identical
    for size in (data.index(b"\n") + 1, len(data) // 3, len(data) - 3):
        file.write_bytes(data[:size])
        with ThreadPoolExecutor(2) as threads:
            assert explored(checkpoint=file, executor=threads).to_json() == alone.to_json()
        assert file.read_bytes() == data
    with pytest.raises(rg.InputError, match="belongs to another run"):
        rg.study(walled_space(), kind).sweep(*axes, trials=13, checkpoint=file)
    line = data.splitlines(keepends=True)[4]
    for damaged, why in (
        (line.replace(b'"chip":3,', b'"chip":4,'), "line 5: its parts do not agree"),
        (line.replace(b'"starts":"', b'"starts":"AAAA'), "line 5: "),
        (b'{"chip":3,"served":64}\n', "line 5: the key 'starts' is missing"),
    ):
        file.write_bytes(data.replace(line, damaged))
        with pytest.raises(rg.InputError, match=why):
            explored(checkpoint=file)


def test_cheapest_is_the_first_value_from_which_the_yield_stays_above_the_target() -> None:
    share = np.array([[0.5, 0.995, 0.98, 0.99, 1.0], [0.1, 0.2, 0.3, 0.4, 0.5], [1.0, 1.0, 1.0, 1.0, 1.0]])
    result = rg.chip.Sweep("a", "b", (1, 2, 3), (6, 8, 10, 12, 14), share, share, share, 10, 0.95)
    assert result.cheapest(0.99) == [12, None, 6]
    assert result.cheapest(0.5) == [6, 14, 6]
    with pytest.raises(rg.InputError, match="fraction"):
        result.cheapest(1.5)
    assert result.to_json()["yield"] == share.tolist()


def test_invalid_sweep_keys_and_values_raise_input_error() -> None:
    for first, message in (
        (("readout.bit", [8]), "did you mean 'readout.bits'"),
        (("readout.bits", [0]), "bits: must be at least 1, got 0"),
        (("mismatch", []), "at least one value"),
        (("readout", [1]), "a chip has no key"),
    ):
        with pytest.raises(rg.InputError, match=message):
            rg.study(walled_space(), CHIP).sweep(first, ("supply", [1.0]))
    with pytest.raises(rg.InputError, match="trials"):
        rg.study(walled_space(), CHIP).sweep(("mismatch", [0.1]), ("supply", [1.0]), trials=0)


@pytest.mark.parametrize("readout", [rg.chip.Readout(), rg.chip.Readout(bits=8)])
def test_yields_and_sweeps_without_a_start_raise_input_error(readout: rg.chip.Readout) -> None:
    """The goal is enclosed by an obstacle: no free cell has a path to the goal."""
    space = space_of(np.array([[2, 1, 0, 0, 1]], dtype=np.uint8))
    made = rg.study(space, rg.Chip(readout=readout, mismatch=0.1, goal_switch_off=1e8))
    for ask in (made.yields, partial(made.sweep, ("mismatch", [0.1]), ("supply", [1.0]), trials=2)):
        with pytest.raises(rg.InputError, match="no free cell has a path to a goal"):
            ask()
