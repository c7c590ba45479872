"""The [chip] table of scenes and the classes `Chip`, `Readout` and `Defects`: values, units and messages.

Tests internals: `resgrid.scene.overrides`.
"""

from __future__ import annotations

import math
from dataclasses import fields

import pytest

import resgrid as rg
from resgrid.scene.overrides import apply_overrides, document_of

SCENE = """
schema = 1
[grid]
axes = [{ name = "x", lower = 0, upper = 4, cells = 4 }, { name = "y", lower = 0, upper = 4, cells = 4 }]
[[goal]]
cell = [0, 0]
[chip]
"""


def chip_of(text: str) -> rg.Chip:
    return rg.parse_scene(SCENE + text, "chip.toml").chip


def test_a_chip_is_ideal_by_default() -> None:
    assert chip_of("") == rg.Chip()


def test_all_values_accept_engineering_notation() -> None:
    chip = chip_of(
        """
        resistance = "4k7"
        supply = 3.3
        capacitance = "1p"
        obstacle_switch_on = 250
        obstacle_switch_off = "10G"
        pelgrom = 2.5
        width = "2u"
        length = "20u"
        gradient = ["5 %", -0.02]
        temperature = 85
        tc1 = "1.5m"
        tc2 = "-400n"
        preferred = "E24"
        rail_resistance = "20m"
        saturation_voltage = "100m"
        seed = 7
        [chip.readout]
        input_resistance = "10meg"
        offset = "2m"
        noise_bandwidth = "1M"
        bits = 10
        figure_of_merit = "50f"
        conversion_time = "100n"
        range = [0, "3.3"]
        [chip.defects]
        open_density = "0.1 %"
        short_density = 1e-4
        short_resistance = 10
        """
    )
    assert (chip.resistance, chip.pelgrom, chip.width, chip.gradient) == (4700.0, 2.5, 2e-6, (0.05, -0.02))
    assert (chip.tc1, chip.tc2, chip.rail_resistance) == (1.5e-3, -4e-7, 0.02)
    assert chip.readout == rg.chip.Readout(10e6, 2e-3, 1e6, 10, (0.0, 3.3), 50e-15, 100e-9)
    assert chip.defects == rg.chip.Defects(1e-3, 1e-4, 10.0)


@pytest.mark.parametrize("value", [0, -0.0, 5e-324, 1e-200, 1e200, 1.7e308, -1e308, 10**400, math.nan, math.inf, True,
                                   "1e308", [1e308, -1e308]])  # fmt: skip
def test_extreme_values_give_a_chip_or_an_input_error(value: object) -> None:
    for kind in (rg.Chip, rg.chip.Readout, rg.chip.Defects):
        for item in fields(kind):
            try:
                made = kind(**{item.name: value})
            except rg.InputError as error:
                assert item.name in str(error)
            else:
                assert kind is not rg.Chip or rg.chip.effects.of_chip(made) is not None


@pytest.mark.parametrize("key", ["temperature", "resistance", "capacitance", "readout.offset", "readout.range"])
@pytest.mark.parametrize("value", ["1e308", "1e-308", "1e309", "nan"])
def test_extreme_values_in_a_scene_are_read_or_rejected_by_name(key: str, value: str) -> None:
    text = SCENE + f"{key} = [{value}, 1]" if key.endswith("range") else SCENE + f"{key} = {value}"
    try:
        chip_of(text.removeprefix(SCENE))
    except rg.InputError as error:
        assert key.rpartition(".")[2] in str(error)
    else:
        assert (key, value) in {("temperature", "1e-308"), ("readout.range", "1e-308")}


def test_fractions_and_percentages_are_equivalent() -> None:
    for text in ("0.1", '"10 %"', '"10%"', '"0.1"', '"100m"'):
        assert chip_of(f"mismatch = {text}").mismatch == 0.1
    assert chip_of('gradient = "7 %"').gradient == (0.07,)


def test_a_chip_reads_back_from_its_document() -> None:
    scene = rg.parse_scene(
        SCENE + 'mismatch = "3 %"\ngradient = [0.1]\n[chip.readout]\nbits = 8\nrange = [0, 1]', "a.toml"
    )
    raw = document_of(scene)
    assert raw["chip"]["gradient"] == [0.1]
    assert raw["chip"]["readout"] == {"bits": 8, "range": [0.0, 1.0]}
    assert scene.replace(chip=rg.Chip(mismatch=0.2)).chip.mismatch == 0.2
    changed = apply_overrides(scene, {"chip.readout.bits": "12", "chip.mismatch": "4 %"})
    assert (changed.chip.readout.bits, changed.chip.mismatch) == (12, 0.04)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("resistance = -1", "line 8: chip.resistance: must be greater than 0, got -1"),
        ('resistance = "10 kohm"', "is not a number"),
        ("[chip.readout]\nbits = 0", "line 9: chip.readout.bits: must be at least 1, got 0"),
        ("[chip.readout]\nbits = 99", "must be at most 32"),
        ("[chip.readout]\nbits = 2.5", "must be a whole number"),
        ("[chip.readout]\nrange = [1, 0]", r"range = \[1.0, 0.0\] is empty"),
        ("[chip.readout]\nrange = [1]", "needs at least 2 entries"),
        ("[chip.readout]\noffsett = 1", "did you mean 'offset'"),
        ("goal_switch_on = 1e6\ngoal_switch_off = 1e3", "chip: goal_switch_on = 1e.06 ohm is not below"),
        ("internodal_switch_on = 5\ninternodal_switch_off = 5", "internodal_switch_on = 5 ohm is not below"),
        ("pelgrom = 2", "pelgrom needs the area of a resistor"),
        ('pelgrom = 2\nwidth = "1u"', "pelgrom needs the area of a resistor"),
        ('mismatch = 0.1\npelgrom = 2\nwidth = "1u"\nlength = "1u"', "both set the standard deviation"),
        ("mismatch = 10", "mismatch = 10 is 1000% of a resistance"),
        ('mismatch = "-3 %"', "must be at least 0"),
        ('mismatch = "ten %"', "is not a fraction"),
        ('gradient = ["100 %", "100 %"]', "makes a resistance negative in a corner of the die"),
        ("temperature = -300", "below absolute zero"),
        ("temperature = 127\ntc1 = -0.02", "tc1 and tc2 multiply resistances by -1"),
        ('preferred = "E25"', "'E25' is unknown"),
        ('preferred = "E24"\nsheet_resistance = 50\nwidth = "1u"', "both restrict the resistances"),
        ("sheet_resistance = 50", "sheet_resistance needs the width"),
        ('sheet_resistance = 50\nwidth = "1u"\nlength = "9u"', "remove length"),
        ("saturation_voltage = 0", "must be greater than 0"),
        ("rail_resistance = -1", "must be at least 0"),
        ("seed = -1", "must be at least 0"),
        ("supply = 0", "drives no current"),
        ("[chip.defects]\nopen_density = 2", "must be at most 1"),
        ("[chip.defects]\nopen_density = 0.6\nshort_density = 0.6", "more than all resistors"),
        ('[chip.defects]\nshort_density = 0.1\nshort_resistance = "20k"', "is not below the resistance of 10000 ohm"),
        ("[chip.defects]\nshort_resistance = 0", "must be greater than 0"),
    ],
)
def test_invalid_chip_tables_give_a_one_line_message(text: str, message: str) -> None:
    with pytest.raises(rg.InputError, match=message) as caught:
        chip_of(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"resistance": -1.0}, "resistance: must be greater than 0, got -1.0"),
        ({"resistance": float("nan")}, "write a finite number"),
        ({"supply": "1 V"}, "'1 V' is not a number"),
        ({"seed": 1.5}, "seed: must be a whole number, got 1.5"),
        ({"preferred": "E7"}, "it may be E6 or E12"),
    ],
)
def test_chips_made_in_python_are_checked(values: dict[str, object], message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        rg.Chip(**values)


def test_a_converter_made_in_python_has_at_least_one_bit() -> None:
    with pytest.raises(rg.InputError, match="bits: must be at least 1, got 0"):
        rg.chip.Readout(bits=0)


@pytest.mark.parametrize(
    "gradient", [float("nan"), "x", True, (), (None,), ("x",), (True,), (float("nan"),), (0.1,) * 5], ids=str
)
def test_gradients_made_in_python_are_several_numbers(gradient: object) -> None:
    with pytest.raises(rg.InputError, match=r"^gradient"):
        rg.Chip(gradient=gradient)  # type: ignore[arg-type]


@pytest.mark.parametrize("limits", [5.0, "ab", True, (None, 1.0), ("x", 1.0), (0.0, 1.0, 2.0), (1.0, 0.0)], ids=str)
def test_ranges_made_in_python_are_two_numbers(limits: object) -> None:
    with pytest.raises(rg.InputError, match=r"^range"):
        rg.chip.Readout(range=limits)  # type: ignore[arg-type]


def test_densities_of_defects_are_numbers() -> None:
    with pytest.raises(rg.InputError, match="open_density: 'x' is not a number"):
        rg.chip.Defects(open_density="x")  # type: ignore[arg-type]
