"""Process data: independent values of the design kit, rules, and messages for unknown names.

Tests internals: `resgrid.processes.reading`.
"""

import re

import pytest

import resgrid as rg
from resgrid.processes.reading import FILES, process_names, read_process


# The labels in ihp/gds/rppd.gds and rhigh.gds of ihp-gdsfactory 2.0.0 state these resistances.
@pytest.mark.parametrize(
    ("name", "length", "ohms"), [("ihp-sg13g2:rppd", 0.5, 396.917), ("ihp-sg13g2:rhigh", 0.96, 3158.0)]
)
def test_the_resistance_is_that_of_the_labels_in_the_design_kit(name, length, ohms):
    resistor = read_process(name).resistor
    assert resistor.resistance(length, 0.5) == pytest.approx(ohms, rel=2e-4)
    assert resistor.length(resistor.resistance(length, 0.5), 0.5) == pytest.approx(length)


@pytest.mark.parametrize("name", process_names())
def test_every_process_has_the_rules_that_a_layout_needs(name):
    process = read_process(name)
    for layer in ("metal1", "metal2"):
        assert process.min_width(layer) > 0
        assert process.min_space(layer) > 0
    for cut, drawn in process.cuts.items():
        assert process.enclosure(cut, drawn.below) == drawn.enclosure_below
        assert process.enclosure(cut, drawn.above) == drawn.enclosure_above
    low, high = (process.resistor.at_corner(corner) for corner in ("low", "high"))
    assert low < process.resistor.sheet_resistance < high
    assert process.resistor is process.resistors[name.partition(":")[2]]


def test_wide_metal_needs_more_space():
    process = read_process("ihp-sg13g2:rppd")
    assert [process.min_space("metal1", width) for width in (0.2, 0.5, 20.0)] == [0.18, 0.22, 0.6]


def test_all_data_files_are_listed():
    from pathlib import Path

    folder = Path(rg.processes.reading.__file__).parent
    assert sorted(FILES.values()) == sorted(path.name for path in folder.glob("*.toml"))


def test_an_unknown_process_is_an_error_that_lists_all():
    with pytest.raises(rg.InputError, match=re.escape("there are ihp-sg13g2:rhigh, ihp-sg13g2:rppd, toy:poly")):
        read_process("ihp-sg13g2")
    with pytest.raises(rg.InputError, match="ihp-sg13g2:rppd"):
        read_process("ihp-sg13g2:rpdd")


def test_a_resistance_below_that_of_the_ends_is_an_error():
    with pytest.raises(rg.InputError, match="two ends, 140 ohm"):
        read_process("ihp-sg13g2:rppd").resistor.length(100.0, 0.5)
    with pytest.raises(rg.InputError, match="smallest width"):
        read_process("ihp-sg13g2:rppd").resistor.length(10e3, 0.1)
