"""Faults one by one, against chips rebuilt with the fault and solved from scratch."""

from __future__ import annotations

import numpy as np
import pytest
from spaces import space_of

import resgrid as rg
from resgrid.device import faces
from resgrid.device.walks import eyes_of, floor_of, walk

FLAWS = rg.Chip(
    mismatch=0.03,
    goal_switch_on=300.0,
    goal_switch_off=1e8,
    obstacle_switch_on=500.0,
    obstacle_switch_off=1e8,
    rail_resistance=3.0,
)


def cells() -> rg.ConfigurationSpace:
    cell = np.zeros((6, 7), dtype=np.uint8)
    cell[1:4, 3] = cell[4, :2] = 1
    cell[1, 1] = 2
    return space_of(cell)


def rebuilt(netlist: rg.Netlist, element: int, short: float | None) -> np.ndarray:
    """Voltages of the faulty chip, solved anew."""
    linear = len(netlist.conductance)
    if element >= linear:
        number = element - linear
        pair = netlist.nonlinear_nodes[number : number + 1]
        faulty = faces.keep_nonlinear(netlist, np.arange(len(netlist.nonlinear_current)) != number)
        faulty = faulty if short is None else faces.add_resistors(faulty, pair, np.array([1 / short]))
    elif short is None:
        faulty = faces.keep_resistors(netlist, np.arange(linear) != element)
    else:
        faulty = netlist.replace(conductance=np.where(np.arange(linear) == element, 1 / short, netlist.conductance))
    return rg.solve(faulty, accuracy="normwise", rtol=1e-13).voltage


@pytest.mark.parametrize("chip", [FLAWS, rg.Chip(), rg.Chip(saturation_voltage=0.4)], ids=["flaws", "plain", "tanh"])
def test_starts_lost_are_those_of_the_faulty_chip(chip: rg.Chip) -> None:
    netlist = rg.build_chip(rg.ideal_netlist(cells(), chip), chip)
    readout = rg.Readout(bits=7)
    result = rg.analyse_criticality(netlist, readout, short_resistance=5.0)
    floor, eyes = floor_of(netlist.layout), eyes_of(readout, netlist.layout, None)
    starts = cells().goal_connected.ravel()
    healthy = walk(rg.solve(netlist).voltage, floor, eyes) & starts
    assert result.served == healthy.sum() > 0
    for short, lost in ((None, result.open), (5.0, result.short)):
        some = range(0, len(lost), 1 if len(lost) < 150 else 4)
        expected = [(healthy & ~walk(rebuilt(netlist, element, short), floor, eyes)).sum() for element in some]
        np.testing.assert_array_equal(lost[some], expected)
        assert max(expected) > 0


def test_bridges_cut_off_what_lies_behind_them() -> None:
    """A corridor with an open edge: every resistor of it is the only way."""
    cell = np.zeros((1, 8), dtype=np.uint8)
    cell[0, 0], cell[0, 7] = 2, 1
    netlist = rg.ideal_netlist(space_of(cell), rg.Chip(), edge="open")
    result = rg.analyse_criticality(netlist)
    assert result.served == 6
    by_face = {int(face): lost for face, lost in zip(netlist.layout.resistor_face, result.open, strict=True)}
    lost = [by_face[face] for face in sorted(by_face)]
    # Both sides of an open sit at their rails' voltages, flat; only the cell beside the goal still sees it lie lower.
    assert lost == [5.0] + [6.0] * 6


def test_driven_grids_lose_the_currents_behind_a_bridge() -> None:
    cell = np.zeros((1, 8), dtype=np.uint8)
    cell[0, 0] = 2
    netlist = rg.ideal_netlist(space_of(cell), rg.Chip(), boundary="neumann")
    result = rg.analyse_criticality(netlist)
    by_face = {int(face): lost for face, lost in zip(netlist.layout.resistor_face, result.open, strict=True)}
    assert [by_face[face] for face in sorted(by_face)] == [7, 6, 5, 4, 3, 2, 1]


def test_time_limits_and_starts() -> None:
    netlist = rg.build_chip(rg.ideal_netlist(cells(), FLAWS), FLAWS)
    told: list[tuple[int, int]] = []
    short = rg.analyse_criticality(netlist, seconds=1e-9, progress=lambda done, total: told.append((done, total)))
    assert 0 < short.examined < len(short.open)
    assert told[0] == (0, len(short.open))
    one = np.zeros((6, 7), dtype=bool)
    one[5, 6] = True
    single = rg.analyse_criticality(netlist, starts=one)
    assert single.served == 1
    assert np.nanmax(single.open) <= 1
    data = single.to_json()
    assert data["starts_served"]["value"] == 1
    assert all(entry["starts_lost"] == 1 for entry in data["worst_open"])
    for options, message in (
        ({"starts": [True]}, "starts must be"),
        ({"short_resistance": 0.0}, "short_resistance"),
    ):
        with pytest.raises(rg.InputError, match=message):
            rg.analyse_criticality(netlist, **options)  # type: ignore[arg-type]
    with pytest.raises(rg.InputError, match="one node per cell"):
        rg.analyse_criticality(rg.compile_space(cells()))
