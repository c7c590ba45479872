"""Causes of yield loss and limits of errors, against yields of chips that are described without the effect.

Tests internals: `resgrid.chip.build`, `resgrid.chip.error_limits`, `resgrid.chip.report`,
`resgrid.chip.report_markdown`, `resgrid.chip.yield_loss`, `resgrid.scene.table_models`.
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import stats
from support.spaces import space_of

import resgrid as rg
from resgrid.chip.build import chip_with
from resgrid.chip.error_limits import bits_ladder, mismatch_ladder, offset_ladder
from resgrid.chip.report import Effort, report_section
from resgrid.chip.report_markdown import report_markdown
from resgrid.chip.yield_loss import EFFECTS, paired_interval
from resgrid.scene.table_models import described_keys

NOT_EFFECTS = {"resistance", "supply", "wall_resistance", "capacitance", "width", "length", "tc1", "tc2",
               "drawing_grid", "seed", "defects.short_resistance", "process", "corner",
               "readout.figure_of_merit", "readout.conversion_time"}  # fmt: skip
"""Keys of the design itself, and keys without an effect of their own."""

CHIP = rg.Chip(
    mismatch=0.1, gradient=(0.1,), goal_switch_on=200.0, rail_resistance=1.0, preferred="E12", temperature=85,
    capacitance=1e-13, seed=7, readout=rg.chip.Readout(bits=9, offset=2e-3, noise_bandwidth=1e6, input_resistance=1e8),
)  # fmt: skip


def walled_space(side: int = 9) -> rg.ConfigurationSpace:
    cell = np.zeros((side, side), dtype=np.uint8)
    cell[3:6, 4] = 1
    cell[1, 1] = 2
    return space_of(cell)


def served(chip: rg.Chip, trials: int, space: rg.ConfigurationSpace | None = None) -> np.ndarray:
    return rg.study(space or walled_space(), chip).yields(trials=trials, batch=trials, half_width=1e-9).served


def test_every_key_of_a_chip_belongs_to_an_effect_or_to_the_design() -> None:
    effects = [key for keys in EFFECTS.values() for key in keys]
    assert len(set(effects)) == len(effects)
    assert set(effects) | NOT_EFFECTS == set(described_keys(rg.Chip))
    assert not set(effects) & NOT_EFFECTS


def test_a_cause_has_the_yield_of_the_chip_without_the_effect() -> None:
    trials = 10
    loss = rg.study(walled_space(), CHIP).yield_loss(trials=trials)
    base, starts = served(CHIP, trials), int(walled_space().goal_connected.sum())
    assert loss.overall.value == base.sum() / (trials * starts)
    assert {cause.name for cause in loss.causes} == {
        "mismatch", "gradient", "preferred values", "temperature", "rail switches", "rail resistance",
        "read-out load", "offset", "noise", "quantization",
    }  # fmt: skip
    for cause in loss.causes:
        without = served(chip_with(CHIP, {key: EFFECTS[cause.name][key] for key in cause.keys}), trials)
        difference = (without - base) / starts
        assert cause.share.value == without.sum() / (trials * starts)
        assert cause.changed == np.count_nonzero(difference)
        assert cause.gain == pytest.approx(difference.mean(), abs=1e-15)
        if cause.changed:
            interval = stats.ttest_1samp(difference, 0.0).confidence_interval(0.95)
            assert (cause.low, cause.high) == pytest.approx((interval.low, interval.high))
    assert [cause.gain for cause in loss.causes] == sorted((cause.gain for cause in loss.causes), reverse=True)


def test_an_effect_without_influence_changes_no_chip() -> None:
    chip = dataclasses.replace(rg.Chip(mismatch=0.1, seed=3), preferred="E24", readout=rg.chip.Readout(bits=7))
    (cause,) = (item for item in rg.study(walled_space(), chip).yield_loss(trials=20).causes if item.name[:4] == "pref")
    assert (cause.gain, cause.changed) == (0.0, 0)  # 10 kohm is a preferred value
    assert (cause.low, cause.high) == pytest.approx((0.05**0.05 - 1, 1 - 0.05**0.05))


@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_paired_intervals_contain_the_mean_with_the_stated_confidence(confidence: float) -> None:
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(400):
        low, high = paired_interval(rng.choice([-0.1, 0.0, 0.3], 40), confidence)
        held += low <= 0.2 / 3 <= high
    assert abs(held / 400 - confidence) < 0.06
    assert paired_interval(np.array([0.5]), confidence) == (-1.0, 1.0)


def test_limits_and_the_next_value_bracket_the_target_yield() -> None:
    chip = dataclasses.replace(CHIP, mismatch=0.02, preferred=None, readout=rg.chip.Readout(bits=12, offset=1e-4))
    trials, space = 16, walled_space(16)
    starts = int(space.goal_connected.sum())
    loss = rg.study(space, chip).yield_loss(trials=trials, target=0.97)
    ladders = {ladder.name: ladder for ladder in (mismatch_ladder(chip), offset_ladder(chip), bits_ladder(chip))}
    assert [limit.name for limit in loss.limits] == list(ladders)
    for limit in loss.limits:
        ladder = ladders[limit.name]
        assert limit.reached
        assert limit.share.value >= 0.97 > limit.beyond_share.value
        rung = ladder.values.index(limit.value)
        assert ladder.values[rung + 1] == limit.beyond
        for value, share in ((limit.value, limit.share), (limit.beyond, limit.beyond_share)):
            alone = served(ladder.chip_with(value), trials, space)
            assert share.value == alone.sum() / (len(alone) * starts)
        assert rung <= ladder.values.index(limit.possible)
        assert dict(limit.tried)[limit.possible].high >= 0.97
        if limit.sure is not None:
            assert ladder.values.index(limit.sure) <= rung
            assert dict(limit.tried)[limit.sure].low >= 0.97
        assert "where the yield is" in limit.answer
    assert loss.figures["fewest_bits"].value == loss.limits[2].value


def test_a_limit_not_reached_at_zero_is_reported_as_such() -> None:
    chip = dataclasses.replace(CHIP, mismatch=0.01, readout=rg.chip.Readout(bits=6, offset=1e-3))
    loss = rg.study(walled_space(), chip).yield_loss(trials=16, target=0.99)
    mismatch, offset, _ = loss.limits
    for limit in (mismatch, offset):
        assert (limit.reached, limit.value, limit.beyond) == (False, None, None)
        assert "not reached even with zero" in limit.answer
        assert "other causes dominate" in limit.figure.definition
        tried = dict(limit.tried)
        assert tried[limit.tolerated].value >= tried[0.0].value - 0.01


def test_pelgrom_and_mismatch_have_the_same_limit() -> None:
    drawn = rg.Chip(pelgrom=5.0, width=1e-6, length=25e-6, readout=rg.chip.Readout(bits=10))
    for chip in (drawn, dataclasses.replace(drawn, length=None, sheet_resistance=400.0)):
        changed = mismatch_ladder(chip).chip_with(0.02)
        assert changed.pelgrom == pytest.approx(10.0)
    same = dataclasses.replace(drawn, pelgrom=None, mismatch=0.01)
    limits = [rg.study(walled_space(), chip).yield_loss(trials=8, target=0.95).limits[0] for chip in (drawn, same)]
    assert limits[0].value == limits[1].value


def test_an_ideal_chip_has_no_causes_of_loss() -> None:
    loss = rg.study(walled_space(), rg.Chip()).yield_loss(trials=4)
    assert loss.causes == ()
    assert loss.overall.value == 1.0
    assert (
        "no single effect"
        in report_section("yield_loss", rg.study(walled_space(), rg.Chip()), Effort(trials=4)).text[0]
    )


def test_gains_of_chips_without_randomness_have_zero_width_intervals() -> None:
    loss = rg.study(walled_space(16), rg.Chip(readout=rg.chip.Readout(bits=8))).yield_loss(trials=4, target=0.9)
    (cause,) = loss.causes
    assert (cause.name, cause.changed, cause.share.value) == ("quantization", 4, 1.0)
    assert cause.low == cause.gain == cause.high > 0
    assert cause.gain == pytest.approx(1.0 - loss.overall.value)


@pytest.mark.slow
def test_yield_loss_depends_on_the_seed_and_not_on_the_executor() -> None:
    study = rg.study(walled_space(), CHIP)
    reports: list[tuple[int, int]] = []
    alone = study.yield_loss(trials=4, progress=lambda done, expected, _: reports.append((done, expected)))
    with ThreadPoolExecutor(2) as threads:
        assert study.yield_loss(trials=4, executor=threads).to_json() == alone.to_json()
    assert isinstance(alone, rg.chip.YieldLoss)
    assert all(done <= expected for done, expected in reports)
    assert rg.study(walled_space(), dataclasses.replace(CHIP, seed=8)).yield_loss(trials=4).to_json() != alone.to_json()


def test_the_report_lists_causes_and_limits() -> None:
    study = rg.study(walled_space(), CHIP)
    section = report_section("yield_loss", study, Effort(trials=16))
    text = report_markdown(study, [section], {}, "")
    assert "## Yield loss" in text
    assert "| switched off | yield |" in text
    assert "| offset (`readout.offset`) |" in text
    for words in (
        "Largest mismatch for 99 %",
        "Largest offset for 99 %",
        "Fewest bits for 99 %",
        "Without its mismatch",
    ):
        assert words in text
