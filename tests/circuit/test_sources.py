"""Voltage and current sources: grounded, floating, in loops and in series, against textbook and closed-form answers."""

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


def test_a_floating_source_fixes_the_difference_of_two_unknowns() -> None:
    point = rg.solve(circuit(4, [(1, 2, 1.0), (3, 0, 1.0)], [(1, 0, 5.0), (2, 3, 2.0)]))
    assert point.voltage.tolist() == pytest.approx([0.0, 5.0, 3.5, 1.5])
    assert point.source_current.tolist() == pytest.approx([-1.5, 1.5])


def test_a_zero_volt_source_is_an_ammeter() -> None:
    point = rg.solve(circuit(4, [(1, 2, 2.0), (3, 0, 2.0)], [(1, 0, 4.0), (2, 3, 0.0)]))
    assert point.source_current.tolist() == pytest.approx([-1.0, 1.0])


def test_a_contradictory_loop_of_sources_raises_circuit_error_with_the_source() -> None:
    with pytest.raises(rg.CircuitError, match=r"source 2 between nodes node_2 and 0 contradicts .* by 1 V"):
        rg.solve(circuit(3, [(1, 0, 1.0)], [(1, 0, 2.0), (1, 2, 1.0), (2, 0, 2.0)]))


def test_a_consistent_loop_of_sources_is_solved_with_nan_currents() -> None:
    with pytest.warns(UserWarning, match="undetermined"):
        point = rg.solve(circuit(4, [(1, 3, 1.0)], [(1, 0, 2.0), (1, 2, 1.0), (2, 0, 1.0), (3, 0, 0.0)]))
    assert point.voltage.tolist() == pytest.approx([0.0, 2.0, 1.0, 0.0])
    assert np.isnan(point.source_current[:3]).all()
    assert point.source_current[3] == pytest.approx(2.0)


def test_a_current_into_a_floating_part_raises_circuit_error() -> None:
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


def test_floating_nodes_are_listed_and_have_nan_voltages() -> None:
    point = rg.solve(circuit(5, [(1, 2, 1.0), (2, 0, 1.0), (3, 4, 1.0)], [(1, 0, 1.0)]))
    assert point.floating.tolist() == [3, 4]
    assert np.isnan(point.voltage[3:]).all()
    assert point.voltage[:3].tolist() == pytest.approx([0.0, 1.0, 0.5])
    assert point.resistor_current[2] == 0.0


def test_an_undriven_space_raises_circuit_error_with_a_remedy() -> None:
    cell = np.zeros((3, 3), dtype=np.uint8)
    cell[0, 0] = 2
    netlist = rg.compile_space(space_of(cell), edge="open")
    with pytest.raises(rg.CircuitError, match="second rail"):
        rg.solve(netlist)
    assert not rg.solve(netlist.replace(cell_map=None)).voltage.any()


def test_a_part_with_one_rail_is_constant_and_listed_as_undriven() -> None:
    point = rg.solve(circuit(6, [(1, 2, 1.0), (2, 0, 1.0), (3, 4, 1.0), (4, 5, 1.0)], [(1, 0, 2.0), (3, 0, 1.5)]))
    assert point.undriven.tolist() == [4, 5]
    assert point.voltage[4:].tolist() == [1.5, 1.5]


def test_a_small_floating_source_current_is_exact_with_large_currents_elsewhere() -> None:
    """The source current equals that of a weak resistor, while the next source carries 5e8 A."""
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
def test_a_small_source_at_a_high_potential_drives_exact_currents(volts: float, step: float) -> None:
    """A difference of rounded voltages would lose 1e-11 V at 1 MV."""
    pairs = [(2, 1, 1e3), (2, 3, 1e3), (3, 1, 1e3 / 3)]
    point = rg.solve(circuit(4, pairs, [(1, 0, volts), (2, 1, step)]))
    assert point.resistor_current == pytest.approx(np.array([1e-3, 7.5e-4, 7.5e-4]) * step, rel=1e-12)
    assert point.source_current[1] == pytest.approx(-1.75e-3 * step, rel=1e-12)
    assert rg.solve(circuit(3, pairs[:1], [(1, 0, volts), (2, 1, step)])).resistor_current == pytest.approx(1e-3 * step)


def test_dead_ends_on_sources_in_series_carry_zero() -> None:
    point = rg.solve(circuit(5, [(2, 1, 1.0), (2, 3, 1.0), (4, 2, 1.0)], [(1, 0, 0.1), (2, 1, 0.2)]))
    assert not point.resistor_current[1:].any()
    assert point.undriven.tolist() == [3, 4]


def test_sources_in_series_beyond_the_range_of_doubles_raise_circuit_error() -> None:
    with pytest.raises(rg.CircuitError, match="in series exceed"):
        rg.solve(circuit(3, [(2, 1, 1.0)], [(1, 0, 1e308), (2, 1, 1e308)]))


@pytest.mark.parametrize("accuracy", ["direction", "normwise"])
def test_currents_of_a_floating_loop_are_known_and_voltages_are_nan(accuracy: str) -> None:
    """Voltages of the loop are undetermined, currents are determined; dead ends of the loop carry zero."""
    pairs = [(1, 0, 1.0), (2, 3, 1e3), (3, 4, 1e3), (5, 2, 1.0), (6, 7, 2.0)]
    point = rg.solve(circuit(8, pairs, [(1, 0, 2.0), (2, 4, 1.0), (6, 7, 3.0)]), accuracy=accuracy)
    assert point.floating.tolist() == [2, 3, 4, 5, 6, 7]
    assert np.isnan(point.voltage[2:]).all()
    assert point.resistor_current == pytest.approx([2.0, 5e-4, 5e-4, 0.0, 1.5])
    assert point.source_current == pytest.approx([-2.0, -5e-4, -1.5])
    assert point.power == pytest.approx(4.0 + 5e-4 + 4.5)
    assert point.potential is not None
    assert point.potential[:2].tolist() == [0.0, 1.0]


def test_source_currents_are_computed_at_the_end_with_the_smaller_currents() -> None:
    """A resistor brings 1e-9 A, or a current source 1e-12 A, while 5e4 A or 1 A flow at the other end."""
    point = rg.solve(circuit(3, [(0, 1, 1.0), (1, 2, 2e-5)], [(2, 1, 1.0), (1, 0, -1e-9)]))
    assert point.source_current == pytest.approx([-5e4, 1e-9], rel=1e-12)
    netlist = circuit(3, [(1, 2, 1.0)], [(1, 2, 1.0), (1, 0, 1.0)])
    point = rg.solve(netlist.replace(current_nodes=[(2, 0)], current_amps=[1e-12]))
    assert point.source_current == pytest.approx([-1.0, -1e-12], rel=1e-9)


@pytest.mark.parametrize("amps", [1e-9, 1e-12, 1e-15, 1e-20])
def test_small_currents_into_joined_nodes_are_exact_with_large_currents_among_them(amps: float) -> None:
    netlist = circuit(4, [(3, 0, 1.0)], [(3, 2, 1.0), (3, 1, 1000.0)])
    point = rg.solve(netlist.replace(current_nodes=[(1, 2), (2, 0)], current_amps=[1.0, amps]))
    assert point.resistor_current == pytest.approx([-amps], rel=1e-9)
    netlist = circuit(3, [(0, 2, 1.0), (1, 2, 1.0)], [(2, 1, 1.0)])
    point = rg.solve(netlist.replace(current_nodes=[(0, 1)], current_amps=[amps]))
    assert point.resistor_current == pytest.approx([-amps, -1.0], rel=1e-9)


def test_a_large_source_without_load_does_not_disturb_small_currents() -> None:
    netlist = circuit(5, [(2, 4, 1.0), (3, 0, 1.0), (0, 4, 1.0)], [(0, 2, 1e-9), (1, 3, 1e6)])
    assert rg.solve(netlist).resistor_current == pytest.approx([-5e-10, 0.0, 5e-10], rel=1e-9)


@pytest.mark.parametrize(("step", "balanced"), [(0.7, False), (1e-9, True)])
def test_currents_of_large_circuits_are_balanced_only_for_small_floating_sources(step: float, balanced: bool) -> None:
    """Rounding of 1.1 V + 0.7 V keeps the accuracy; rounding of 1.1 V + 1e-9 V does not."""
    mesh = np.arange(150 * 150).reshape(150, 150)
    sides = ((mesh[1:], mesh[:-1]), (mesh[:, 1:], mesh[:, :-1]))
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in sides])
    held = [[1, 0], [2, 1]]
    netlist = rg.Netlist(mesh.size, pairs, np.ones(len(pairs)), source_nodes=held, source_volts=[1.1, step])
    point = rg.solve(netlist)
    assert ("balance" in point.seconds) is balanced
    between = np.flatnonzero((pairs == [2, 1]).all(axis=1))
    assert point.resistor_current[between] == pytest.approx([step], rel=1e-12)


def test_large_currents_that_cancel_at_ground_do_not_hide_a_small_one() -> None:
    netlist = circuit(3, [(1, 2, 1.0)], [(1, 0, 3.3)])
    point = rg.solve(netlist.replace(current_nodes=[(1, 0), (2, 0), (2, 0)], current_amps=[1e-20, -1e-3, 1e-3]))
    assert point.source_current == pytest.approx([-1e-20], rel=1e-9)


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (4, 3, 2, 1, 0), (3, 4, 0, 2, 1)])
def test_a_contradiction_of_small_sources_is_found_in_a_loop_with_large_ones(order: tuple[int, ...]) -> None:
    sources = [(5, 3, 1e6), (5, 6, -1e-9), (4, 6, 1e-9), (4, 5, 2.1e-9), (4, 3, 1e6 + 2.1e-9)]  # 4-5-6: by 1e-10 V
    netlist = circuit(7, [(node, 0, 1e3) for node in range(1, 7)], [sources[number] for number in order])
    with pytest.raises(rg.CircuitError, match=r"contradicts the other sources by 1(\.0*\d*)?e-10 V"):
        rg.solve(netlist)


def test_parallel_sources_on_a_stack_of_larger_ones_do_not_contradict_each_other() -> None:
    """The rounding error of 0.1 V + 0.2 V is far above 1e-25 V."""
    stack = rg.Netlist(
        4, [[3, 0]], [1.0], source_nodes=[[1, 0], [2, 1], [3, 2], [3, 2]], source_volts=[0.1, 0.2, 1e-25, 1e-25]
    )
    with pytest.warns(UserWarning, match="2 voltage sources form loops"):
        assert rg.solve(stack).voltage[3] == pytest.approx(0.3, rel=1e-15)
    with pytest.raises(rg.CircuitError, match="contradicts the other sources by 1e-25 V"):
        rg.solve(stack.replace(source_volts=[0.1, 0.2, 1e-25, 2e-25]))


def test_balanced_current_sources_do_not_connect_a_circuit_to_ground() -> None:
    floating = rg.Netlist(3, [[1, 2]], [1.0], current_nodes=[[0, 1], [2, 0]], current_amps=[1.0, 1.0])
    with pytest.raises(rg.CircuitError, match="no resistor or voltage source touches ground"):
        rg.solve(floating)
