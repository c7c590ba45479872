"""Circuits with memristors, against closed forms, scipy's integrators and the laws of charge-controlled resistors."""

from __future__ import annotations

import itertools

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.memristors import LAW, DenseMemristors, chain, loop, random_memristive, state_at_constant_voltage
from support.spaces import space_of

import resgrid as rg

TIMES = np.linspace(0.0, 1.0, 41)
SPAN = LAW.off_resistance - LAW.on_resistance
TRIANGLE = np.array([[0, 0], [1, 4], [3, -4], [4, 0]]) / 4
SINE = np.column_stack([np.linspace(0, 1, 101), np.sin(2 * np.pi * np.linspace(0, 1, 101))])


def law(**changes: object) -> rg.circuit.Memristor:
    """Return the law of the tests with changed fields."""
    fields = {name: getattr(LAW, name) for name in LAW.__dataclass_fields__}
    return rg.circuit.Memristor(**{**fields, **changes})


def film(**changes: object) -> rg.circuit.Memristor:
    """Return the law of a film with changed measures."""
    return rg.circuit.Memristor.thin_film(100.0, 16e3, **{"mobility": 1e-14, "thickness": 1e-8, **changes})


def run(netlist: rg.Netlist, own: rg.circuit.Memristor = LAW, **options: object) -> rg.circuit.MemristiveTransient:
    """Return the transient of a netlist of memristors, with a tolerance of 1e-10."""
    circuit = {name: options.pop(name) for name in ("memristors", "polarity", "state") if name in options}
    times = options.pop("times", TIMES)
    return rg.circuit.memristive_transient(
        rg.circuit.MemristiveCircuit(netlist, own, **circuit), times, **{"tolerance": 1e-10, **options}
    )


@pytest.mark.parametrize("volts", [1.0, -1.0, 0.3])
@pytest.mark.parametrize("initial", [0.0, 0.4, 1.0])
@pytest.mark.quick_cases(4)
def test_one_memristor_at_a_constant_voltage_has_its_closed_form(volts: float, initial: float) -> None:
    own = law(initial=initial)
    found = run(loop(volts), own)
    wanted = state_at_constant_voltage(own, volts, TIMES)
    assert np.abs(found.state[:, 0] - wanted).max() < 1e-10
    ohms = own.off_resistance - SPAN * wanted
    assert np.allclose(found.resistance[:, 0], ohms, rtol=1e-9)
    assert np.allclose(found.current[:, 0], volts / ohms, rtol=1e-9)
    assert np.array_equal(found.voltage, np.tile([0.0, volts], (len(TIMES), 1)))
    assert np.allclose(found.energy[:, 0], volts * found.charge[:, 0], rtol=1e-9, atol=1e-18)


@pytest.mark.slow
def test_the_switching_time_has_its_closed_form() -> None:
    half = (LAW.off_resistance**2 - (LAW.off_resistance - SPAN / 2) ** 2) / (2 * SPAN * LAW.rate)
    assert run(loop()).switching_time == pytest.approx([half], rel=1e-9)
    assert np.isnan(run(loop(), polarity=-1).switching_time).all()
    assert run(loop(), law(initial=0.5)).switching_time[0] == 0.0


@pytest.mark.parametrize("count", [2, 5])
def test_equal_memristors_in_series_divide_the_voltage(count: int) -> None:
    found = run(chain(count, volts=float(count)))
    assert np.abs(found.state - state_at_constant_voltage(LAW, 1.0, TIMES)[:, None]).max() < 1e-10
    assert np.allclose(found.voltage[:, 1:], np.arange(count, 0, -1), rtol=1e-9)


def test_memristors_of_opposite_polarity_in_series_keep_their_resistance() -> None:
    found = run(chain(2), polarity=[1, -1], state=[0.1, 0.9], times=np.linspace(0, 0.7, 8))
    amps = 1 / (LAW.off_resistance + LAW.on_resistance)
    assert np.allclose(found.current, amps, rtol=1e-10)
    assert np.allclose(found.state[:, 0], 0.1 + LAW.rate * amps * found.times, atol=1e-10)
    assert np.allclose(found.state.sum(axis=1), 1.0, atol=1e-10)


@pytest.mark.slow
def test_memristors_in_parallel_do_not_act_on_each_other() -> None:
    state = np.array([0.0, 0.2, 0.5])
    found = run(loop(count=3), state=state)
    wanted = np.array([state_at_constant_voltage(law(initial=x), 1.0, TIMES) for x in state]).T
    assert np.abs(found.state - wanted).max() < 1e-10


def test_a_current_source_moves_the_state_by_its_charge() -> None:
    driven = rg.Netlist(2, [[1, 0]], [1.0], current_nodes=[[0, 1]], current_amps=[5e-5])
    found = run(driven)
    assert np.allclose(found.charge[:, 0], 5e-5 * TIMES, rtol=1e-12, atol=1e-20)
    assert np.allclose(found.state[:, 0], LAW.rate * 5e-5 * TIMES, atol=1e-12)
    logistic = run(driven, law(window="joglekar", initial=0.2))
    odds = 0.25 * np.exp(4 * LAW.rate * 5e-5 * TIMES)
    assert np.abs(logistic.state[:, 0] - odds / (1 + odds)).max() < 1e-10


def test_a_capacitor_discharges_through_a_memristor_as_in_closed_form() -> None:
    """The memristor-capacitor circuit of Joglekar & Wolf 2009: ``M(q) q' = V0 - q / C``, integrated to ``t(q)``."""
    farads, volts = 5e-5, 1.0
    netlist = rg.Netlist(2, [[1, 0]], [1.0], capacitor_nodes=[[1, 0]], capacitance=[farads])
    found = run(netlist, initial=[0.0, volts], times=np.linspace(0.05, 2.0, 20))
    charge, left = found.charge[:, 0], found.voltage[:, 1]
    assert np.allclose(left, volts - charge / farads, atol=1e-10)
    slow = LAW.off_resistance - SPAN * LAW.rate * farads * volts
    wanted = farads * (slow * np.log(volts / left) + SPAN * LAW.rate * farads * (volts - left))
    assert np.allclose(wanted, found.times, rtol=1e-8)


@pytest.mark.parametrize("waveform", [None, SINE[::4] * [0.2, 1.0]], ids=["constant", "sine"])
@pytest.mark.parametrize("capacitors", [False, True])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.quick_cases(5)
def test_random_circuits_agree_with_an_explicit_integrator(
    seed: int, capacitors: bool, waveform: np.ndarray | None
) -> None:
    circuit, times = random_memristive(seed, capacitors=capacitors), np.linspace(0, 0.2, 6)
    found = rg.circuit.memristive_transient(circuit, times, waveform=waveform, tolerance=1e-7)
    factor = (lambda _: 1.0) if waveform is None else lambda t: float(np.interp(t, *waveform.T))
    state, voltage = DenseMemristors(circuit, factor).run(times)
    # The reference passes a limit by up to 3e-6 before its drift vanishes there.
    assert np.abs(found.state - state).max() < 1e-5
    assert np.abs(found.voltage[1:] - voltage[1:]).max() < 1e-5 * max(1.0, np.ptp(voltage))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.quick_cases(2)
def test_random_circuits_with_the_joglekar_window_agree_with_an_explicit_integrator(seed: int) -> None:
    circuit, times = random_memristive(seed, capacitors=seed % 2 == 0, window="joglekar"), np.linspace(0, 0.1, 6)
    found = rg.circuit.memristive_transient(circuit, times, tolerance=1e-7)
    state, voltage = DenseMemristors(circuit).run(times)
    assert np.abs(found.state - state).max() < 1e-7
    assert np.abs(found.voltage[1:] - voltage[1:]).max() < 1e-7 * max(1.0, np.ptp(voltage))


@settings(max_examples=4)
@given(seed=st.integers(0, 10**6), capacitors=st.booleans())
@pytest.mark.slow
def test_the_state_is_a_function_of_the_charge(seed: int, capacitors: bool) -> None:
    circuit = random_memristive(seed, capacitors=capacitors, window="joglekar")
    own, times = circuit.law, np.linspace(0, 0.1, 5)
    found = rg.circuit.memristive_transient(circuit, times, waveform=TRIANGLE * [0.1, 1.0], tolerance=1e-7)
    x = np.linspace(0, 1, 20001)[1:-1]
    charge = (
        np.concatenate([[0.0], np.cumsum(np.diff(x) / (1 - (x[1:] + x[:-1] - 1) ** (2 * own.exponent)))]) / own.rate
    )
    moved = np.interp(found.state, x, charge) - np.interp(circuit.state, x, charge)
    inside = (found.state > 0.01) & (found.state < 0.99)
    assert np.abs(moved - circuit.polarity * found.charge)[inside].max(initial=0.0) < 1e-3 / own.rate


@settings(max_examples=5)
@given(seed=st.integers(0, 10**6), capacitors=st.booleans())
@pytest.mark.slow
def test_memristors_are_passive_and_their_loops_are_pinched(seed: int, capacitors: bool) -> None:
    circuit = random_memristive(seed, capacitors=capacitors)
    found = rg.circuit.memristive_transient(circuit, np.linspace(0, 0.3, 7), waveform=TRIANGLE * [0.2, 1.0])
    assert (np.diff(found.energy, axis=0) >= -1e-15).all()
    assert (found.state >= 0).all() and (found.state <= 1).all()
    ends = circuit.netlist.resistor_nodes[circuit.memristors]
    drop = found.voltage[:, ends[:, 0]] - found.voltage[:, ends[:, 1]]
    assert np.allclose(found.current * found.resistance, drop, rtol=1e-9, atol=1e-12)
    assert (found.current * drop >= 0).all()


def test_the_current_is_zero_where_the_voltage_is_and_a_period_restores_the_state() -> None:
    found = run(loop(0.2), law(initial=0.3), waveform=SINE, times=np.linspace(0, 1, 101))
    assert np.abs(found.current[[0, 50, 100], 0]).max() < 1e-15
    assert found.state[-1, 0] == pytest.approx(0.3, abs=1e-10)
    half = found.state[:51, 0]
    assert half[-1] > 0.31 and np.allclose(half, found.state[:49:-1, 0], atol=1e-10)


@pytest.mark.slow
def test_a_state_rests_at_a_limit_until_the_current_reverses() -> None:
    there_and_back = [[0.0, 1.0], [1.0, 1.0], [1.1, -1.0], [3.0, -1.0]]
    found = run(loop(), waveform=there_and_back, times=[0.9, 1.0, 1.05, 1.06, 3.0])
    assert found.state[:3, 0] == pytest.approx([1.0, 1.0, 1.0], abs=1e-10)
    flux = 0.01**2 * 20 / 2  # the waveform falls by 20 per second from 0 at 1.05 s
    ohms = np.sqrt(LAW.on_resistance**2 + 2 * SPAN * LAW.rate * flux)
    assert found.resistance[3, 0] == pytest.approx(ohms, rel=1e-8)
    assert found.state[-1, 0] == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("end", [1e20, 1e300])
@pytest.mark.parametrize("window", ["rectangular", "joglekar"])
def test_a_state_may_switch_in_any_fraction_of_the_time(end: float, window: str) -> None:
    own = law(initial=0.3, window=window)
    found = run(loop(), own, times=[0.2, end], tolerance=1e-6)
    assert found.state[0] == pytest.approx(run(loop(), own, times=[0.2]).state[0], abs=1e-6)
    assert found.state[1] == pytest.approx(1.0)
    assert found.charge[1] == pytest.approx(end / own.on_resistance)


def test_the_error_falls_with_the_tolerance() -> None:
    wanted = state_at_constant_voltage(LAW, 1.0, TIMES)
    for tolerance in (1e-3, 1e-5, 1e-7, 1e-9):
        assert np.abs(run(loop(), tolerance=tolerance).state[:, 0] - wanted).max() < tolerance


def test_antiparallel_memristors_lower_their_resistance_for_both_directions() -> None:
    for volts in (1.0, -1.0):
        circuit = rg.circuit.MemristiveCircuit.antiparallel(loop(volts), LAW)
        found = rg.circuit.memristive_transient(circuit, [0.0, 1.0])
        assert sorted(found.state[-1]) == pytest.approx([0.0, 1.0], abs=1e-10)
        assert found.current[-1].sum() == pytest.approx(volts * (1 / LAW.on_resistance + 1 / LAW.off_resistance))


def test_a_compiled_grid_starts_from_its_operating_point() -> None:
    cell = np.zeros((5, 4), dtype=np.uint8)
    cell[2, 1], cell[4, 3] = 1, 2
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(0, 0))
    circuit = rg.circuit.MemristiveCircuit.antiparallel(netlist, LAW)
    found = rg.circuit.memristive_transient(circuit, [0.0, 0.1])
    assert np.allclose(found.voltage[0], rg.solve(circuit.netlist).voltage, atol=1e-12)
    assert np.allclose(found.voltage[1], rg.solve(circuit.netlist_at(found.state[1])).voltage, atol=1e-12)
    assert circuit.netlist.cells.resistor_face.shape == (len(circuit.netlist.conductance),)


def test_a_cost_map_is_rejected() -> None:
    cell = np.zeros((3, 2), dtype=np.uint8)
    cell[2, 1] = 2
    plain = space_of(cell)
    for cost, is_rejected in ((np.full((3, 2), 2.0), False), (1.0 + np.arange(6.0).reshape(3, 2), True)):
        space = rg.ConfigurationSpace(plain.axes, cell, conductivity=cost)
        netlist = rg.compile_space(space, boundary="neumann", drive="start", start=(0, 0))
        for make in (rg.circuit.MemristiveCircuit, rg.circuit.MemristiveCircuit.antiparallel):
            if is_rejected:
                with pytest.raises(rg.InputError, match="the netlist has a cost map"):
                    make(netlist, LAW)
            else:
                assert (make(netlist, LAW).netlist.conductance == 1 / LAW.off_resistance).all()


def test_none_selects_the_defaults_of_a_circuit() -> None:
    """None selects all resistors as memristors, and the initial state of the law."""
    implicit = rg.circuit.MemristiveCircuit(loop(1.0), LAW)
    explicit = rg.circuit.MemristiveCircuit(loop(1.0), LAW, memristors=None, state=None)
    for name in ("memristors", "polarity", "state"):
        np.testing.assert_array_equal(getattr(explicit, name), getattr(implicit, name))
    with pytest.raises(rg.InputError, match=r"memristors = 'all' must be numbers, or None"):
        rg.circuit.MemristiveCircuit(loop(1.0), LAW, memristors="all")


def test_floating_nodes_have_no_voltage_and_floating_sources_are_kept() -> None:
    netlist = rg.Netlist(7, [[1, 2], [3, 0], [5, 6]], [1.0] * 3, source_nodes=[[1, 0], [3, 2]], source_volts=[1.0, 0.5])
    found = run(netlist, times=[0.1, 0.2])
    assert np.isnan(found.voltage[:, 4:]).all() and np.isfinite(found.voltage[:, :4]).all()
    assert np.allclose(found.voltage[:, 3] - found.voltage[:, 2], 0.5, atol=1e-12)
    assert np.allclose(found.state[:, 0], state_at_constant_voltage(LAW, 0.75, found.times), atol=1e-10)
    assert (found.current[:, 2] == 0).all()


def test_progress_is_reported_and_can_stop_the_integration() -> None:
    seen: list[tuple[int, float, float | None]] = []
    found = run(loop(), tolerance=1e-4, progress=lambda *report: seen.append(report))
    assert [step for step, _, _ in seen] == list(range(1, found.steps + 1))
    left = [part for _, part, _ in seen]
    assert left == sorted(left, reverse=True) and left[-1] == 0.0 and seen[-1][2] == 0.0

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(loop(), progress=stop)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rg.circuit.Memristor(100.0, 10.0, 1e4), "on_resistance = 100 ohm must be below off_resistance = 10"),
        (lambda: rg.circuit.Memristor(100.0, 1e3, 0.0), "rate = 0.0 must be a finite number above 0"),
        (lambda: law(initial=1.5), "initial = 1.5"),
        (lambda: film(thickness=0.0), "thickness = 0.0 must be a finite number above 0"),
        (lambda: film(thickness=-1e-8), "thickness = -1e-08 must be"),
        (lambda: film(thickness="10n"), "thickness = '10n' must be"),
        (lambda: film(mobility=-1e-14), "mobility = -1e-14 must be"),
        (lambda: film(thickness=1e-200), "rate = inf must be"),
        (lambda: rg.circuit.MemristiveCircuit.antiparallel(None, LAW), "netlist = None must be a Netlist"),
        (lambda: rg.circuit.MemristiveCircuit.antiparallel(LAW, loop()), "netlist = <a Memristor> must be"),
        (lambda: law(window="joglekar"), "would never change"),
        (lambda: LAW.resistance([0.5, 2.0]), "numbers from 0"),
        (lambda: run(loop(), state=-0.1), "state = -0.1 of memristor 0 must lie between 0"),
        (lambda: run(loop(), state=[0.1, 0.2]), "give one number, or one for each of the 1 memristors"),
        (lambda: run(loop(), polarity=0), "polarity must hold only 1 and -1"),
        (lambda: run(loop(), memristors=[1]), "memristors names resistor 1"),
        (lambda: run(loop(), memristors=[0, 0]), "names a resistor twice"),
        (lambda: run(loop(), memristors=[]), "at least one entry"),
        (lambda: run(rg.Netlist(2, np.zeros((0, 2), int), [])), "no resistors"),
        (lambda: run(loop(), times=[0.0]), "times ends at 0 s"),
        (lambda: run(loop(), times=[-1.0]), "must be finite, at least 0 and ascending"),
        (lambda: run(loop(), waveform=[0.0, 1.0]), "pairs of a time and a factor"),
        (lambda: run(loop(), waveform=[[0.0, 1.0], [0.0, 2.0]]), "strictly ascending"),
        (lambda: run(loop(), waveform=[[0.0, np.inf]]), "finite times and factors"),
        (lambda: run(loop(), tolerance=0.0), "tolerance = 0.0"),
        (lambda: rg.circuit.memristive_transient(loop(), [1.0]), r"rg.circuit.MemristiveCircuit\(netlist, law\)"),
        (
            lambda: run(
                rg.Netlist(2, [[1, 0]], [1.0], nonlinear_nodes=[[1, 0]], nonlinear_current=[1], nonlinear_voltage=[1])
            ),
            "1 nonlinear resistors, which cannot be combined",
        ),
    ],
)
def test_bad_input_is_one_clear_message(make: object, words: str) -> None:
    with pytest.raises(rg.InputError, match=words):
        make()


def test_separate_routes_switch_in_the_ratio_of_their_lengths() -> None:
    lengths = (3, 4, 7)
    nodes, links = 2, []
    for length in lengths:
        way = [1, *range(nodes, nodes + length - 1), 0]
        links += list(itertools.pairwise(way))
        nodes += length - 1
    netlist = rg.Netlist(nodes, links, np.ones(len(links)), source_nodes=[[1, 0]], source_volts=[1.0])
    first = run(netlist, times=[5.0], tolerance=1e-8).switching_time
    half = (LAW.off_resistance**2 - (LAW.off_resistance - SPAN / 2) ** 2) / (2 * SPAN * LAW.rate)
    assert np.allclose(first, np.repeat(lengths, lengths) * half, rtol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_exactly_the_solution_of_a_perfect_maze_is_recorded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = nx.convert_node_labels_to_integers(nx.grid_2d_graph(4, 4))
    nx.set_edge_attributes(grid, {edge: rng.random() for edge in grid.edges}, "weight")
    tree = nx.minimum_spanning_tree(grid)
    ends = np.array(tree.edges)
    netlist = rg.Netlist(16, ends, np.ones(len(ends)), source_nodes=[[15, 0]], source_volts=[1.0])
    polarity = rng.choice([-1, 1], len(ends))
    found = run(netlist, law(initial=0.5), polarity=polarity, times=[0.2], tolerance=1e-6)
    changed = {frozenset(pair) for pair in ends[np.abs(found.state[0] - 0.5) > 1e-6].tolist()}
    assert changed == {frozenset(pair) for pair in itertools.pairwise(nx.shortest_path(tree, 15, 0))}


@pytest.mark.parametrize("seed", range(3))
def test_the_first_route_of_a_maze_with_loops_is_a_shortest_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = nx.convert_node_labels_to_integers(nx.grid_2d_graph(4, 4))
    nx.set_edge_attributes(grid, {edge: rng.random() for edge in grid.edges}, "weight")
    maze = nx.Graph(nx.minimum_spanning_tree(grid).edges)
    maze.add_edges_from(edge for edge in grid.edges if rng.random() < 0.3)
    ends = np.array(maze.edges)
    netlist = rg.Netlist(16, ends, np.ones(len(ends)), source_nodes=[[15, 0]], source_volts=[1.0])
    length = nx.shortest_path_length(maze, 15, 0)
    whole = length * (LAW.off_resistance + LAW.on_resistance) / LAW.rate
    pairs = rg.circuit.MemristiveCircuit.antiparallel(netlist, LAW)
    switched = rg.circuit.memristive_transient(pairs, [whole], tolerance=1e-3).switching_time
    first, route = np.fmin(*np.split(switched, 2)), nx.Graph([(15, 15), (0, 0)])
    for link in np.argsort(first):
        route.add_edge(*ends[link].tolist())
        if nx.has_path(route, 15, 0):
            break
    assert np.isfinite(first[link]) and nx.shortest_path_length(route, 15, 0) == length
