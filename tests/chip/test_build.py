"""Building chips, one by one and by the thousand, and what ngspice says of them.

Tests internals: `resgrid.chip.effects.values`, `resgrid.core.random_sites`, `resgrid.spice.run.ngspice`,
`resgrid.spice.write.flat`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.chip.effects.values import Temperature
from resgrid.core.random_sites import generator, seed_of
from resgrid.spice.run.ngspice import simulate
from resgrid.spice.write.flat import flatten

SWITCHES = {
    "obstacle_switch_on": 100.0,
    "obstacle_switch_off": 1e9,
    "goal_switch_on": 100.0,
    "goal_switch_off": 1e9,
    "internodal_switch_on": 100.0,
    "internodal_switch_off": 1e9,
}
CHIPS = {
    "mismatch": rg.Chip(mismatch=0.1, gradient=(0.1, 0.2), wall_resistance=5e3),
    "switches": rg.Chip(**SWITCHES, wall_resistance=5e3),
    "rails": rg.Chip(rail_resistance=0.1, wall_resistance=5e3),
    "heat": rg.Chip(temperature=85.0, tc1=1e-3, tc2=1e-6, wall_resistance=5e3),
    "defects": rg.Chip(defects=rg.chip.Defects(0.05, 0.05), wall_resistance=5e3),
    "everything": rg.Chip(
        preferred="E24", mismatch=0.1, rail_resistance=0.1, temperature=85.0, tc1=1e-3, wall_resistance=5e3,
        readout=rg.chip.Readout(input_resistance=1e8), **SWITCHES,
    ),
    "saturation": rg.Chip(saturation_voltage=0.2, mismatch=0.1, rail_resistance=0.1, wall_resistance=5e3, **SWITCHES),
}  # fmt: skip


def scene() -> rg.ConfigurationSpace:
    cell = np.zeros((16, 16), dtype=np.uint8)
    cell[3:9, 7], cell[12, 3], cell[1, 14] = rg.Cell.OBSTACLE, rg.Cell.GOAL, rg.Cell.GOAL
    return space_of(cell)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann", "wall"])
@pytest.mark.parametrize("name", CHIPS)
def test_ngspice_agrees_about_the_very_same_chip(name: str, boundary: str) -> None:
    wall = {"wall_resistance": 5e3} if boundary == "wall" else {}
    netlist = rg.chip.build_chip(rg.compile_space(scene(), boundary=boundary, rails="cells", **wall), CHIPS[name])
    tolerance = 1e-6 if name == "saturation" else 1e-9
    agreement = rg.check_deck(netlist, tolerance=tolerance)
    assert agreement.agrees, agreement


def test_ngspice_heats_the_chip_by_its_own_coefficients(tmp_path: Path) -> None:
    chip = rg.Chip(tc1=2e-3, tc2=-3e-6, mismatch=0.1, **SWITCHES)
    netlist = rg.study(scene(), chip).netlist
    deck = tmp_path / "hot.cir"
    deck.write_text(flatten(netlist).text.replace("\n.end", "\n.temp 110\n.end"))
    told = simulate(deck.read_bytes()).voltage
    point = rg.solve(Temperature(110.0).apply(netlist))
    names = netlist.names_of(np.arange(1, netlist.node_count))
    apart = [abs(told[name] - volts) for name, volts in zip(names, point.voltage[1:].tolist(), strict=True)]
    assert max(apart) < 1e-9
    assert np.abs(point.voltage - rg.solve(netlist).voltage).max() > 1e-4


@pytest.mark.parametrize(
    "chip",
    [
        rg.Chip(mismatch=0.2),
        rg.Chip(mismatch=0.2, **SWITCHES, rail_resistance=1.0, temperature=60.0, tc1=1e-3, gradient=(0.1,)),
        rg.Chip(pelgrom=5.0, width=1e-6, sheet_resistance=250.0, internodal_switch_on=300.0),
        rg.Chip(pelgrom=5.0, width=1e-6, length=4e-6),
        rg.Chip(),
    ],
)
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_thousands_of_chips_are_those_built_one_by_one(chip: rg.Chip, boundary: str) -> None:
    netlist = rg.compile_space(scene(), rails="cells", boundary=boundary)
    seeds = [3, (3, 0), np.random.SeedSequence(3).spawn(2)[1]]
    circuit, samples = rg.study(netlist, chip).conductances(seeds)
    assert samples.shape == (3, len(circuit.conductance))
    for seed, row in zip(seeds, samples, strict=True):
        one = rg.chip.build_chip(netlist, chip, seed)
        np.testing.assert_array_equal(one.resistor_nodes, circuit.resistor_nodes)
        np.testing.assert_allclose(row, one.conductance, rtol=1e-12)
    if chip == rg.Chip(mismatch=0.2):
        assert np.abs(np.log(samples[0] / samples[1])).max() > 0.1


def test_chips_that_differ_in_more_than_values_are_built_one_by_one() -> None:
    netlist = rg.compile_space(scene(), rails="cells")
    for chip in (rg.Chip(saturation_voltage=1.0), rg.Chip(defects=rg.chip.Defects(0.1))):
        with pytest.raises(rg.InputError, match="build them one by one"):
            rg.study(netlist, chip).conductances([1])


def test_an_ideal_chip_is_the_netlist_itself() -> None:
    netlist = rg.compile_space(scene())
    assert rg.chip.effects.of_chip(rg.Chip()) == ()
    assert rg.chip.build_chip(netlist, rg.Chip()) is netlist


def test_streams_and_children_do_not_overlap() -> None:
    draws = {
        tuple(generator(seed, stream).integers(0, 2**63, 3).tolist())
        for seed in (0, 1, (0, 0), (0, 1), (1, 0), (0, 0, 1))
        for stream in (1, 2, 3)
    }
    assert len(draws) == 18
    child = np.random.SeedSequence(5).spawn(3)[2]
    assert seed_of(child) == (5, 2)


@pytest.mark.parametrize("seed", [-1, 1.5, "7", None, True, (), (1, -2), [None]])
def test_seeds_are_whole_numbers(seed: object) -> None:
    with pytest.raises(rg.InputError, match="must be a whole number"):
        seed_of(seed)


def test_the_chip_of_a_scene_is_built_as_its_table_says() -> None:
    text = """
    schema = 1
    [grid]
    axes = [{ name = "x", lower = 0, upper = 6, cells = 6 }, { name = "y", lower = 0, upper = 6, cells = 6 }]
    [[goal]]
    cell = [4, 4]
    [chip]
    resistance = "20k"
    supply = 3.3
    mismatch = "5 %"
    seed = 11
    """
    found = rg.parse_scene(text, "chip.toml")
    chip = rg.study(found)
    assert chip.netlist.cells.wiring.supply == 3.3
    ratio = 1 / (chip.netlist.conductance * 20e3)
    assert 0.03 < ratio.std() < 0.07
    again = rg.chip.build_chip(rg.study(rg.build_space(found), found.chip).ideal, found.chip, 11)
    np.testing.assert_array_equal(chip.netlist.conductance, again.conductance)
    assert repr(chip) == "Study(chip: 6 x 6 cells, dirichlet, 38 nodes)"
    assert "<td>mismatch</td>\n<td>0.05</td>" in chip._repr_html_()
