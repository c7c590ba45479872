"""The process of a chip: its values in every analysis, precedence of explicit keys, corners and messages."""

import numpy as np
import pytest

import resgrid as rg

RPPD = "ihp-sg13g2:rppd"
LESSON = "examples/scenes/lesson.toml"


@pytest.fixture(scope="module")
def scene():
    return rg.read_scene(LESSON)


def test_the_mismatch_of_many_dies_is_that_of_an_independent_simulation(scene):
    # r3_cmc of the design kit: deviations of sheet resistance, width and length with their own areas.
    w, ohms, dies = 0.8, 20e3, 400
    length = ohms * w / 260.0
    random = np.random.default_rng(1)
    sheet = 260.0 * np.exp(0.015 / np.sqrt(w * length) * random.standard_normal(200_000))
    width = w + 0.01 / np.sqrt(length) * random.standard_normal(200_000)
    long = length + 0.01 / np.sqrt(w) * random.standard_normal(200_000)
    expected = np.std(sheet * long / width) / ohms

    chip = rg.Chip(process=RPPD, width="0.8u", resistance=ohms)
    _, conductance = rg.study(scene, chip).conductances(range(dies))
    spread = (1 / conductance).std(axis=0) / ohms
    assert spread.mean() == pytest.approx(expected, rel=0.01)


def test_the_deviation_falls_with_the_root_of_the_area(scene):
    coefficient = [rg.Chip(process=RPPD, width=width).with_process() for width in (1e-6, 4e-6)]
    sigma = [chip.pelgrom / 100 / (1e6 * np.sqrt(chip.width * chip.width * 1e4 / 260)) for chip in coefficient]
    assert sigma[0] > 4 * sigma[1]


def test_explicit_keys_win_over_the_process():
    chip = rg.Chip(process=RPPD, pelgrom=3.0, tc1=1e-3, sheet_resistance=300.0, width="2u", gradient=(0.01,))
    found = chip.with_process()
    assert (found.pelgrom, found.tc1, found.tc2, found.sheet_resistance) == (3.0, 1e-3, 4e-7, 300.0)
    assert (found.width, found.gradient, found.process) == (2e-6, (0.01,), None)
    assert rg.Chip(process=RPPD, mismatch=0.02).with_process().pelgrom is None
    assert rg.Chip(process="toy:poly").with_process().gradient == (0.01,)


def test_a_corner_scales_all_resistances_and_keeps_the_paths(scene):
    typical, high = (rg.study(scene, rg.Chip(process=RPPD, corner=corner)) for corner in ("typical", "high"))
    assert high.power().total == pytest.approx(typical.power().total * 260 / 286, rel=1e-3)
    assert high.adc_resolution().bits_for(0.99) == typical.adc_resolution().bits_for(0.99)


def test_yield_against_area_is_one_sweep(scene):
    study = rg.study(scene, rg.Chip(process="ihp-sg13g2:rhigh", resistance="30k"))
    sweep = study.sweep(("width", (5e-7, 8e-6)), ("readout.bits", (8, 14)), trials=16)
    assert sweep.share[1, 1] >= sweep.share[0, 1]
    assert sweep.share[0, 1] > 0


def test_the_process_is_an_effect_of_the_yield_loss(scene):
    chip = rg.Chip(process="ihp-sg13g2:rhigh", readout=rg.chip.Readout(bits=10))
    causes = {cause.name for cause in rg.study(scene, chip).yield_loss(trials=8).causes}
    assert "mismatch" in causes


def test_the_process_scales_to_a_temperature(scene):
    cold, hot = (
        rg.study(scene, rg.Chip(process="ihp-sg13g2:rhigh", temperature=t)).power().total for t in (27.0, 127.0)
    )
    assert hot == pytest.approx(cold / (1 - 0.23 + 0.021), rel=1e-6)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"process": "ihp-sg13g2:rpdd"}, "there are ihp-sg13g2:rhigh, ihp-sg13g2:rppd, toy:poly"),
        ({"corner": "low"}, "needs a process"),
        ({"process": RPPD, "preferred": "E12"}, "process and preferred contradict"),
        ({"process": RPPD, "length": 1e-5}, "remove length or process"),
        ({"process": RPPD, "width": 1e-7}, "below the smallest width"),
        ({"process": RPPD, "resistance": 100.0}, "below the smallest length"),
        ({"process": RPPD, "sheet_resistance": 250.0, "corner": "low"}, "has no effect"),
        ({"process": RPPD, "pelgrom": 1.0, "mismatch": 0.1}, "both set the standard deviation"),
    ],
)
def test_contradictions_are_errors(keys, message):
    with pytest.raises(rg.InputError, match=message):
        rg.Chip(**keys)
