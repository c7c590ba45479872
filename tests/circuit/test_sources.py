import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg


def circuit(nodes: int, resistors: list[tuple[int, int, float]], sources: list[tuple[int, int, float]]) -> rg.Netlist:
    return rg.Netlist(
        nodes,
        np.array([r[:2] for r in resistors]),
        np.array([1.0 / r[2] for r in resistors]),
        source_nodes=np.array([s[:2] for s in sources]),
        source_volts=np.array([s[2] for s in sources]),
    )


def test_a_divider_has_the_textbook_answer_with_spice_signs() -> None:
    point = rg.solve(circuit(3, [(1, 2, 1e3), (2, 0, 3e3)], [(1, 0, 4.0)]))
    assert point.voltage.tolist() == pytest.approx([0.0, 4.0, 3.0])
    assert point.source_current.tolist() == pytest.approx([-1e-3])
    assert point.power == pytest.approx(4e-3)


def test_a_floating_source_ties_two_unknowns() -> None:
    point = rg.solve(circuit(4, [(1, 2, 1.0), (3, 0, 1.0)], [(1, 0, 5.0), (2, 3, 2.0)]))
    assert point.voltage.tolist() == pytest.approx([0.0, 5.0, 3.5, 1.5])
    assert point.source_current.tolist() == pytest.approx([-1.5, 1.5])


def test_a_zero_volt_source_is_an_ammeter() -> None:
    point = rg.solve(circuit(4, [(1, 2, 2.0), (3, 0, 2.0)], [(1, 0, 4.0), (2, 3, 0.0)]))
    assert point.source_current.tolist() == pytest.approx([-1.0, 1.0])


def test_a_contradictory_loop_is_refused_and_named() -> None:
    with pytest.raises(rg.CircuitError, match=r"source 2 between nodes node_2 and 0 contradicts .* by 1 V"):
        rg.solve(circuit(3, [(1, 0, 1.0)], [(1, 0, 2.0), (1, 2, 1.0), (2, 0, 2.0)]))


def test_a_consistent_loop_is_solved_with_unknown_currents() -> None:
    with pytest.warns(UserWarning, match="undetermined"):
        point = rg.solve(circuit(4, [(1, 3, 1.0)], [(1, 0, 2.0), (1, 2, 1.0), (2, 0, 1.0), (3, 0, 0.0)]))
    assert point.voltage.tolist() == pytest.approx([0.0, 2.0, 1.0, 0.0])
    assert np.isnan(point.source_current[:3]).all()
    assert point.source_current[3] == pytest.approx(2.0)


def test_a_current_into_a_floating_part_is_refused() -> None:
    netlist = rg.Netlist(
        4,
        np.array([[1, 0], [2, 3]]),
        np.ones(2),
        source_nodes=np.array([[1, 0]]),
        source_volts=np.ones(1),
        current_nodes=np.array([[0, 2]]),
        current_amps=np.ones(1),
    )
    with pytest.raises(rg.CircuitError, match="node_2"):
        rg.solve(netlist)


def test_a_floating_part_is_data_not_an_error() -> None:
    point = rg.solve(circuit(5, [(1, 2, 1.0), (2, 0, 1.0), (3, 4, 1.0)], [(1, 0, 1.0)]))
    assert point.floating.tolist() == [3, 4]
    assert np.isnan(point.voltage[3:]).all()
    assert point.voltage[:3].tolist() == pytest.approx([0.0, 1.0, 0.5])
    assert point.resistor_current[2] == 0.0


def test_a_space_in_which_nothing_is_driven_is_an_error_that_says_what_to_do() -> None:
    cell = np.zeros((3, 3), dtype=np.uint8)
    cell[0, 0] = 2
    netlist = rg.compile_space(space_of(cell), edge="open")
    with pytest.raises(rg.CircuitError, match="second rail"):
        rg.solve(netlist)
    assert not rg.solve(netlist.replace(cell_map=None)).voltage.any()


def test_a_part_with_one_rail_is_flat_and_reported() -> None:
    point = rg.solve(circuit(6, [(1, 2, 1.0), (2, 0, 1.0), (3, 4, 1.0), (4, 5, 1.0)], [(1, 0, 2.0), (3, 0, 1.5)]))
    assert point.undriven.tolist() == [4, 5]
    assert point.voltage[4:].tolist() == [1.5, 1.5]


def test_a_floating_source_keeps_its_digits_beside_larger_currents() -> None:
    """What a weak resistor takes from a node is what the only source there gives, with 5e8 A in the next one."""
    netlist = rg.Netlist(
        6, [[3, 1], [4, 1], [1, 0], [1, 0], [2, 1], [3, 1], [4, 3], [5, 4]],
        [100.0, 1e-11, 1e-06, 1e-08, 1e-10, 0.01, 0.0001, 1e8],
        source_nodes=[[5, 3], [2, 5], [4, 5]], source_volts=[2.0, 2.0, 5.0],
        current_nodes=[[4, 0], [1, 3]], current_amps=[-1.0, 0.001],
    )  # fmt: skip
    op = rg.solve(netlist)
    assert op.source_current[1] == pytest.approx(-op.resistor_current[4], rel=1e-9)
    assert op.source_current == pytest.approx([0.9992999995288989, -4.0100089990953797e-10, -499999999.0007], rel=1e-9)


@pytest.mark.parametrize(("volts", "step"), [(1e3, 1e-9), (1e6, 1e-9), (1e6, 1e-11), (0.1, 0.2)])
def test_a_small_source_high_above_ground_drives_what_it_says(volts: float, step: float) -> None:
    """What it drives is no difference of rounded voltages: 1e-11 V at 1 MV is below their last digit."""
    pairs = [(2, 1, 1e3), (2, 3, 1e3), (3, 1, 1e3 / 3)]
    point = rg.solve(circuit(4, pairs, [(1, 0, volts), (2, 1, step)]))
    assert point.resistor_current == pytest.approx(np.array([1e-3, 7.5e-4, 7.5e-4]) * step, rel=1e-12)
    assert point.source_current[1] == pytest.approx(-1.75e-3 * step, rel=1e-12)
    assert rg.solve(circuit(3, pairs[:1], [(1, 0, volts), (2, 1, step)])).resistor_current == pytest.approx(1e-3 * step)


def test_dead_ends_at_a_sum_of_sources_carry_nothing() -> None:
    point = rg.solve(circuit(5, [(2, 1, 1.0), (2, 3, 1.0), (4, 2, 1.0)], [(1, 0, 0.1), (2, 1, 0.2)]))
    assert not point.resistor_current[1:].any()
    assert point.undriven.tolist() == [3, 4]


def test_sources_in_series_beyond_the_range_of_doubles_are_refused() -> None:
    with pytest.raises(rg.CircuitError, match="in series exceed"):
        rg.solve(circuit(3, [(2, 1, 1.0)], [(1, 0, 1e308), (2, 1, 1e308)]))


@pytest.mark.parametrize("accuracy", ["direction", "normwise"])
def test_a_source_drives_a_loop_that_floats(accuracy: str) -> None:
    """Its voltages are unknown, its currents are not; nothing flows from a loop to what hangs on it."""
    pairs = [(1, 0, 1.0), (2, 3, 1e3), (3, 4, 1e3), (5, 2, 1.0), (6, 7, 2.0)]
    point = rg.solve(circuit(8, pairs, [(1, 0, 2.0), (2, 4, 1.0), (6, 7, 3.0)]), accuracy=accuracy)
    assert point.floating.tolist() == [2, 3, 4, 5, 6, 7]
    assert np.isnan(point.voltage[2:]).all()
    assert point.resistor_current == pytest.approx([2.0, 5e-4, 5e-4, 0.0, 1.5])
    assert point.source_current == pytest.approx([-2.0, -5e-4, -1.5])
    assert point.power == pytest.approx(4.0 + 5e-4 + 4.5)
    assert point.potential is not None
    assert point.potential[:2].tolist() == [0.0, 1.0]


def test_a_source_carries_what_is_told_where_less_flows() -> None:
    """Beside 5e4 A at its other end: 1e-9 A come from ground through a resistor, or 1e-12 A of a current source."""
    point = rg.solve(circuit(3, [(0, 1, 1.0), (1, 2, 2e-5)], [(2, 1, 1.0), (1, 0, -1e-9)]))
    assert point.source_current == pytest.approx([-5e4, 1e-9], rel=1e-12)
    netlist = circuit(3, [(1, 2, 1.0)], [(1, 2, 1.0), (1, 0, 1.0)])
    point = rg.solve(netlist.replace(current_nodes=[(2, 0)], current_amps=[1e-12]))
    assert point.source_current == pytest.approx([-1.0, -1e-12], rel=1e-9)


@pytest.mark.parametrize("amps", [1e-9, 1e-12, 1e-15, 1e-20])
def test_what_flows_into_nodes_that_sources_join_is_not_lost_beside_what_flows_among_them(amps: float) -> None:
    netlist = circuit(4, [(3, 0, 1.0)], [(3, 2, 1.0), (3, 1, 1000.0)])
    point = rg.solve(netlist.replace(current_nodes=[(1, 2), (2, 0)], current_amps=[1.0, amps]))
    assert point.resistor_current == pytest.approx([-amps], rel=1e-9)
    netlist = circuit(3, [(0, 2, 1.0), (1, 2, 1.0)], [(2, 1, 1.0)])
    point = rg.solve(netlist.replace(current_nodes=[(0, 1)], current_amps=[amps]))
    assert point.resistor_current == pytest.approx([-amps, -1.0], rel=1e-9)


def test_a_high_source_with_nothing_behind_it_is_solved() -> None:
    netlist = circuit(5, [(2, 4, 1.0), (3, 0, 1.0), (0, 4, 1.0)], [(0, 2, 1e-9), (1, 3, 1e6)])
    assert rg.solve(netlist).resistor_current == pytest.approx([-5e-10, 0.0, 5e-10], rel=1e-9)


@pytest.mark.parametrize(("step", "balanced"), [(0.7, False), (1e-9, True)])
def test_large_circuits_are_balanced_for_small_sources_alone(step: float, balanced: bool) -> None:
    """Sums of 1.1 V and 0.7 V are no doubles, but good enough; 1e-9 V above 1.1 V are not."""
    mesh = np.arange(150 * 150).reshape(150, 150)
    sides = ((mesh[1:], mesh[:-1]), (mesh[:, 1:], mesh[:, :-1]))
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in sides])
    held = [[1, 0], [2, 1]]
    netlist = rg.Netlist(mesh.size, pairs, np.ones(len(pairs)), source_nodes=held, source_volts=[1.1, step])
    point = rg.solve(netlist)
    assert ("balance" in point.seconds) is balanced
    between = np.flatnonzero((pairs == [2, 1]).all(axis=1))
    assert point.resistor_current[between] == pytest.approx([step], rel=1e-12)


def test_currents_that_cancel_at_ground_hide_no_smaller_one() -> None:
    netlist = circuit(3, [(1, 2, 1.0)], [(1, 0, 3.3)])
    point = rg.solve(netlist.replace(current_nodes=[(1, 0), (2, 0), (2, 0)], current_amps=[1e-20, -1e-3, 1e-3]))
    assert point.source_current == pytest.approx([-1e-20], rel=1e-9)


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (4, 3, 2, 1, 0), (3, 4, 0, 2, 1)])
def test_a_large_source_within_a_loop_hides_no_contradiction_of_small_ones(order: tuple[int, ...]) -> None:
    sources = [(5, 3, 1e6), (5, 6, -1e-9), (4, 6, 1e-9), (4, 5, 2.1e-9), (4, 3, 1e6 + 2.1e-9)]  # 4-5-6: by 1e-10 V
    netlist = circuit(7, [(node, 0, 1e3) for node in range(1, 7)], [sources[number] for number in order])
    with pytest.raises(rg.CircuitError, match=r"contradicts the other sources by 1(\.0*\d*)?e-10 V"):
        rg.solve(netlist)
