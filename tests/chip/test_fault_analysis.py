"""Single faults, against chips rebuilt with the fault and solved from scratch, and against exact fractions.

Tests internals: `resgrid.chip.effects.base`, `resgrid.chip.fault_analysis`, `resgrid.chip.walk`,
`resgrid.core.netlist`.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.chip.effects.base import add_nodes
from resgrid.chip.fault_analysis import faulty_voltages
from resgrid.chip.walk import converter_of, neighbours_of, reaches_goal
from resgrid.core.netlist import add_elements, select_elements

FLAWS = rg.Chip(
    mismatch=0.03,
    goal_switch_on=300.0,
    goal_switch_off=1e8,
    obstacle_switch_on=500.0,
    obstacle_switch_off=1e8,
    rail_resistance=3.0,
)


def walled_space() -> rg.ConfigurationSpace:
    cell = np.zeros((6, 7), dtype=np.uint8)
    cell[1:4, 3] = cell[4, :2] = 1
    cell[1, 1] = 2
    return space_of(cell)


def rebuilt_voltages(netlist: rg.Netlist, element: int, short: float | None) -> np.ndarray:
    """Return the voltages of the rebuilt faulty chip."""
    linear = len(netlist.conductance)
    if element >= linear:
        number = element - linear
        pair = netlist.nonlinear_nodes[number : number + 1]
        faulty = select_elements(netlist, "nonlinear resistor", np.arange(len(netlist.nonlinear_current)) != number)
        faulty = faulty if short is None else add_elements(faulty, "resistor", pair, 1 / short)
    elif short is None:
        faulty = select_elements(netlist, "resistor", np.arange(linear) != element)
    else:
        faulty = netlist.replace(conductance=np.where(np.arange(linear) == element, 1 / short, netlist.conductance))
    return rg.solve(faulty, accuracy="normwise", rtol=1e-13).voltage


@pytest.mark.parametrize("chip", [FLAWS, rg.Chip(), rg.Chip(saturation_voltage=0.4)], ids=["flaws", "plain", "tanh"])
@pytest.mark.quick_cases(1)
def test_lost_starts_equal_those_of_the_rebuilt_faulty_chip(chip: rg.Chip) -> None:
    netlist = rg.chip.build_chip(rg.study(walled_space(), chip).ideal, chip)
    readout = rg.chip.Readout(bits=7)
    result = rg.study(netlist).faults(readout=readout, short_resistance=5.0)
    neighbours, converter = neighbours_of(netlist.cells), converter_of(readout, netlist.cells, None)
    starts = walled_space().goal_connected.ravel()
    healthy = reaches_goal(rg.solve(netlist).voltage, neighbours, converter) & starts
    assert result.served == healthy.sum() > 0
    for short, lost in ((None, result.open), (5.0, result.short)):
        some = range(0, len(lost), 1 if len(lost) < 150 and chip.saturation_voltage is None else 8)
        expected = [
            (healthy & ~reaches_goal(rebuilt_voltages(netlist, element, short), neighbours, converter)).sum()
            for element in some
        ]
        np.testing.assert_array_equal(lost[some], expected)
        assert max(expected) > 0


def test_opens_in_a_single_corridor_lose_all_starts_behind_them() -> None:
    """In a corridor with an open edge every resistor is a bridge of the graph."""
    cell = np.zeros((1, 8), dtype=np.uint8)
    cell[0, 0], cell[0, 7] = 2, 1
    netlist = rg.study(space_of(cell), rg.Chip(), edge="open").ideal
    result = rg.study(netlist).faults()
    assert result.served == 6
    by_face = {int(face): lost for face, lost in zip(netlist.cells.resistor_face, result.open, strict=True)}
    lost = [by_face[face] for face in sorted(by_face)]
    # Both sides of an open are flat at their rail voltages; only the cell next to the goal has a lower neighbour.
    assert lost == [5.0] + [6.0] * 6


def test_opens_in_a_driven_corridor_lose_only_the_starts_behind_them() -> None:
    cell = np.zeros((1, 8), dtype=np.uint8)
    cell[0, 0] = 2
    netlist = rg.study(space_of(cell), rg.Chip(), boundary="neumann").ideal
    result = rg.study(netlist).faults()
    by_face = {int(face): lost for face, lost in zip(netlist.cells.resistor_face, result.open, strict=True)}
    assert [by_face[face] for face in sorted(by_face)] == [7, 6, 5, 4, 3, 2, 1]


def test_faults_obeys_time_limit_and_starts_and_rejects_invalid_options() -> None:
    netlist = rg.chip.build_chip(rg.study(walled_space(), FLAWS).ideal, FLAWS)
    reports: list[tuple[int, int]] = []
    short = rg.study(netlist).faults(seconds=1e-9, progress=lambda done, total: reports.append((done, total)))
    assert 0 < short.examined < len(short.open)
    assert reports[0] == (0, len(short.open))
    one = np.zeros((6, 7), dtype=bool)
    one[5, 6] = True
    single = rg.study(netlist).faults(starts=one)
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
            rg.study(netlist).faults(**options)  # type: ignore[arg-type]
    with pytest.raises(rg.InputError, match="one node per cell"):
        rg.study(rg.compile_space(walled_space())).faults()


@pytest.mark.parametrize("leak", [1e7, 1.7e11, 1.7e12])
@pytest.mark.parametrize("short", [1.0, 3e9])
def test_faulty_voltages_with_only_leaks_to_a_rail_equal_exact_fractions(leak: float, short: float) -> None:
    """Every open cuts this driven corridor; only leaks then connect the far part to a rail."""
    cell = np.array([[0, 0, 0, 0, 2]], dtype=np.uint8)
    chip = rg.Chip(goal_switch_off=leak, mismatch=0.3)
    netlist = rg.chip.build_chip(rg.study(space_of(cell), chip, boundary="neumann", edge="open").ideal, chip)
    order = np.arange(len(netlist.conductance))
    for element, *faulty in faulty_voltages(netlist, rg.solve(netlist).voltage, order, short):
        for siemens, volts in zip((0.0, 1 / short), faulty, strict=True):
            conductance = netlist.conductance.copy()
            conductance[element] = siemens
            wanted = exact_voltages(netlist, conductance)
            assert volts == pytest.approx(wanted, abs=1e-12 * np.abs(wanted).max())


def exact_voltages(netlist: rg.Netlist, conductance: np.ndarray) -> np.ndarray:
    """Return node voltages by elimination in fractions; every voltage source is grounded."""
    known = {0: Fraction(0)} | {
        int(plus): Fraction(volts) for (plus, _), volts in zip(netlist.source_nodes, netlist.source_volts, strict=True)
    }
    free = [node for node in range(netlist.node_count) if node not in known]
    rows = {node: {other: Fraction(0) for other in [*free, None]} for node in free}
    for ends, siemens in zip(netlist.resistor_nodes.tolist(), conductance.tolist(), strict=True):
        for here, there in (ends, ends[::-1]):
            if here in known:
                continue
            rows[here][here] += Fraction(siemens)
            if there in known:
                rows[here][None] += Fraction(siemens) * known[there]
            else:
                rows[here][there] -= Fraction(siemens)
    for (start, end), amps in zip(netlist.current_nodes.tolist(), netlist.current_amps.tolist(), strict=True):
        for node, sign in ((start, -1), (end, 1)):
            if node not in known:
                rows[node][None] += sign * Fraction(amps)
    for k in free:
        rows[k] = {node: value / rows[k][k] for node, value in rows[k].items()}
        for i in free:
            if i != k:
                rows[i] = {node: value - rows[i][k] * rows[k][node] for node, value in rows[i].items()}
    return np.array([float(known[node] if node in known else rows[node][None]) for node in range(netlist.node_count)])


def test_worst_rejects_unknown_fault_kinds_and_limits_its_length() -> None:
    result = rg.study(walled_space(), rg.Chip()).faults()
    with pytest.raises(rg.InputError, match="'bogus' is unknown"):
        result.worst("bogus")
    assert len(result.worst("short", 3)) <= 3


@pytest.mark.parametrize(
    "options",
    [{"short_resistance": value} for value in (0.0, -1.0, np.nan, np.inf, "x", True)]
    + [{"seconds": value} for value in ("x", np.nan)],
    ids=str,
)
def test_invalid_fault_options_raise_input_error(options: dict[str, object]) -> None:
    with pytest.raises(rg.InputError, match=next(iter(options))):
        rg.study(walled_space(), rg.Chip()).faults(**options)


def test_a_fault_between_floating_nodes_loses_no_starts() -> None:
    netlist = rg.study(walled_space(), FLAWS).netlist
    more, nodes = add_nodes(netlist, 2)
    more = add_elements(more, "resistor", nodes, 1e-3)
    alone, beside = (rg.study(each).faults() for each in (netlist, more))
    for fault in ("open", "short"):
        np.testing.assert_array_equal(beside.lost(fault), np.append(alone.lost(fault), 0.0))
