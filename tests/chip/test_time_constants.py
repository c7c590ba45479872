"""Time constants and settling where symmetry, weak ties and far-apart scales make them hard, against exact laws.

Tests internals: `resgrid.chip.time_constants`, `resgrid.circuit.dynamics`.
"""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy.linalg import eigh, eigvalsh
from support.dynamics import with_capacitors

import resgrid as rg
from resgrid.chip.time_constants import fastest_time_constant, slowest_modes
from resgrid.circuit.dynamics import dynamics_of

Floats = NDArray[np.float64]
HALF_STEPS = np.log(2.0**11)
"""Time constants in which 1 V falls to half a step of 10 bits of it."""


def symmetric_grid(shape: tuple[int, ...], goal: tuple[int, ...], periodic: bool, boundary: str) -> rg.Netlist:
    cell = np.zeros(shape, dtype=np.uint8)
    cell[goal] = 2
    axes = [rg.Axis("xyz"[i], 0, n, n, periodic) for i, n in enumerate(shape)]
    return with_capacitors(rg.compile_space(rg.ConfigurationSpace(axes, cell), boundary=boundary), 1e-12)


def laplacian(count: int, nodes: Floats, values: Floats) -> Floats:
    matrix = np.zeros((count, count))
    for (a, b), value in zip(nodes, values, strict=True):
        matrix[[a, b], [a, b]] += value
        matrix[[a, b], [b, a]] -= value
    return matrix


@pytest.mark.parametrize("modes", [1, 4, 6, 8, 13])
@pytest.mark.parametrize(
    ("shape", "goal", "periodic", "boundary"),
    [
        ((6, 6, 6), (0, 0, 0), True, "neumann"),
        ((20, 20), (0, 0), True, "neumann"),
        ((21, 21), (10, 10), False, "dirichlet"),
        ((7, 7, 7), (3, 3, 3), False, "neumann"),
    ],
)
def test_no_twin_is_missed_on_symmetric_grids(
    shape: tuple[int, ...], goal: tuple[int, ...], periodic: bool, boundary: str, modes: int
) -> None:
    netlist = symmetric_grid(shape, goal, periodic, boundary)
    free = netlist.cells.free_node
    G = laplacian(netlist.node_count, netlist.resistor_nodes, netlist.conductance)[np.ix_(free, free)]
    dynamics = dynamics_of(netlist)
    slow = slowest_modes(dynamics, modes)
    tau, mode = slow.tau[:modes], (slow.shape * np.sqrt(slow.tau))[:, :modes]
    assert tau == pytest.approx(np.sort(1e-12 / eigvalsh(G))[::-1][:modes], rel=1e-9)
    assert mode.T @ (dynamics.conductance.matrix @ mode) == pytest.approx(np.eye(modes), abs=1e-7)


def test_a_large_grid_with_few_capacitors() -> None:
    netlist = symmetric_grid((19, 19), (2, 5), False, "neumann")
    netlist = netlist.replace(capacitor_nodes=[[30, 0], [200, 0], [30, 200]], capacitance=[1e-12, 3e-12, 2e-12])
    free = netlist.cells.free_node
    G, C = (
        laplacian(netlist.node_count, nodes, values)[np.ix_(free, free)]
        for nodes, values in (
            (netlist.resistor_nodes, netlist.conductance), (netlist.capacitor_nodes, netlist.capacitance),
        )
    )  # fmt: skip
    exact = eigh(C, G, eigvals_only=True)[::-1][:2]
    dynamics = dynamics_of(netlist)
    assert slowest_modes(dynamics, 6).tau == pytest.approx(exact, rel=1e-9)
    assert fastest_time_constant(dynamics) == pytest.approx(exact[1], rel=1e-6)


@pytest.mark.parametrize("ratio", [1e6, 1e13, 1e15, 1e17, 1e20])
def test_a_pair_tied_weakly_to_two_rails(ratio: float) -> None:
    netlist = rg.Netlist(
        4, [[2, 3], [1, 2], [3, 0]], [1.0, 1 / ratio, 2 / ratio], [[1, 0]], [1.0],
        capacitor_nodes=[[2, 0], [3, 0]], capacitance=[1e-12, 1e-12],
    )  # fmt: skip
    with mp.workdps(60):
        r = 1 / mp.mpf(ratio)
        exact = [float(mp.mpf("1e-12") / value) for value in mp.eigsy(mp.matrix([[1 + r, -1], [-1, 1 + 2 * r]]))[0]]
    result = rg.study(netlist).settling(span=1.0)
    assert result.time_constants == pytest.approx(exact, rel=1e-9)
    assert result.fastest == pytest.approx(exact[1], rel=1e-9)
    assert result.settle_time == pytest.approx(exact[0] * np.log(2.0**11 / 3), rel=1e-5)


def island(side: int, ratio: float) -> rg.Netlist:
    """A square of nodes joined by 1 S, all tied to 1 V by ``1 / ratio``, with 1 pF each."""
    node = np.arange(2, side * side + 2).reshape(side, side)
    inner = [(node[:-1], node[1:]), (node[:, :-1], node[:, 1:])]
    pairs = np.concatenate([[[1, 2]], *(np.stack([a.ravel(), b.ravel()], axis=1) for a, b in inner)])
    caps = np.stack([node.ravel(), 0 * node.ravel()], axis=1)
    conductance = np.append(1 / ratio, np.ones(len(pairs) - 1))
    return rg.Netlist(
        side * side + 2, pairs, conductance, [[1, 0]], [1.0], capacitor_nodes=caps, capacitance=np.full(side**2, 1e-12)
    )


@pytest.mark.parametrize("side", [5, 18])
@pytest.mark.parametrize("ratio", [1e10, 1e13, 1e15, 1e17])
def test_an_island_tied_weakly_charges_as_one_capacitor(side: int, ratio: float) -> None:
    result = rg.study(island(side, ratio)).settling()
    tau = side**2 * 1e-12 * ratio
    assert result.time_constants[0] == pytest.approx(tau, rel=1e-8)
    assert result.settle_time == pytest.approx(tau * HALF_STEPS, rel=1e-8)
    assert result.energy == pytest.approx(side**2 * 1e-12 * (1 - 2.0**-11), rel=1e-8)


@pytest.mark.parametrize("side", [5, 18])
def test_an_island_that_rounding_unties_is_refused(side: int) -> None:
    with pytest.raises(rg.AccuracyError, match="too many orders of magnitude"):
        rg.study(island(side, 1e30)).settling()
    with pytest.raises(rg.AccuracyError, match="too many orders of magnitude"):
        slowest_modes(dynamics_of(island(side, 1e30)), 1)


def two_lags(fast: float, slow: float) -> rg.Netlist:
    return rg.Netlist(
        4, [[1, 2], [1, 3]], [1e-3, 1e-3], [[1, 0]], [1.0], capacitor_nodes=[[2, 0], [3, 0]],
        capacitance=[1e-3 * fast, 1e-3 * slow],
    )  # fmt: skip


@pytest.mark.parametrize(("fast", "slow"), [(1e-9, 1e-9), (1e-9, 1e-3), (1e-15, 1.0)])
def test_lags_far_apart_settle_on_their_own(fast: float, slow: float) -> None:
    result = rg.study(two_lags(fast, slow)).settling()
    assert result.node_time[2:] == pytest.approx([fast * HALF_STEPS, slow * HALF_STEPS], rel=1e-9)
    assert result.energy == pytest.approx(1e-3 * (fast + slow) * (1 - 2.0**-11), rel=1e-2)


def test_time_and_energy_end_with_the_last_node_that_moves() -> None:
    result = rg.study(two_lags(1e-9, 1e-3)).settling(initial=[0.0, 1.0, 0.0, 0.9996])
    assert result.settle_time == pytest.approx(1e-9 * HALF_STEPS, rel=1e-9)
    slow = 1e-6 * 0.0004 * -np.expm1(-result.settle_time / 1e-3)
    assert result.energy == pytest.approx(1e-12 * (1 - 2.0**-11) + slow, rel=1e-9)
    assert result.times[-1] >= result.settle_time
    assert np.interp(result.settle_time, result.times, result.distance) == pytest.approx(result.span / 2**11, rel=0.02)


def test_capacitors_in_series_between_loose_nodes_stay_below_the_bound() -> None:
    n, R, C = 16, 1e6, 1e-9
    pairs = np.array([[2 * k + 1, 2 * k + 2] for k in range(n)])
    links = [[2 * k, 2 * k + 1] for k in range(n)]
    netlist = rg.Netlist(
        2 * n + 1, [*links, *pairs.tolist()], [1.0] * n + [1 / R] * n, capacitor_nodes=pairs, capacitance=[C] * n
    )
    start = np.zeros(2 * n + 1)
    start[pairs[:, 0]], start[pairs[:, 1]] = np.arange(n), np.arange(n) + 1
    result = rg.study(netlist).settling(initial=start, span=1.0)
    assert result.settle_time == pytest.approx(R * C * np.log(n * 2.0**11), rel=1e-9)
    assert result.settle_time <= result.bound


class ExactLags:
    """Deviations of a circuit with a capacitor at every node, from eigenvectors in 50 digits."""

    def __init__(self, G: Floats, C: Floats, start: Floats) -> None:
        with mp.workdps(50):
            root = [mp.sqrt(mp.mpf(value)) for value in C]
            n = len(C)
            A = mp.matrix(n, n)
            for i in range(n):
                for j in range(n):
                    if i != j:
                        A[i, j] = mp.mpf(G[i, j]) / (root[i] * root[j])
                        A[i, i] -= mp.mpf(G[i, j]) / C[i]
                A[i, i] += mp.mpf(G[i, i]) / C[i]
            rates, Q = mp.eigsy(A)
            held = [sum(Q[i, k] * root[i] * mp.mpf(start[i]) for i in range(n)) for k in range(n)]
            self.share = np.array([[float(Q[i, k] / root[i] * held[k]) for k in range(n)] for i in range(n)])
            self.rate = np.array([float(rate) for rate in rates])

    def at(self, times: Floats) -> Floats:
        return self.share @ np.exp(-np.outer(self.rate, times))

    def settled(self, band: float) -> Floats:
        """When every node last leaves the band, by looking closely and halving."""
        times = np.append(0.0, np.geomspace(1e-4 / self.rate.max(), 60 / self.rate.min(), 20000))
        result = np.zeros(len(self.share))
        for row, outside in enumerate(np.abs(self.at(times)) > band):
            if not outside.any():
                continue
            low, high = times[np.flatnonzero(outside)[-1] + np.array([0, 1])]
            for _ in range(60):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if abs(self.at(np.array([middle]))[row, 0]) <= band else (middle, high)
            result[row] = high
        return result


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), iterated=st.booleans())
def test_every_node_settles_when_its_exponentials_say(seed: int, iterated: bool) -> None:
    rng = np.random.default_rng(seed)
    n, decades = int(rng.integers(3, 8)), float(rng.choice([0.5, 3.0, 6.0]))
    tree = [[k, int(rng.integers(0, k))] for k in range(1, n + 1)]
    nodes = np.array(tree + [[int(rng.integers(1, n)), n] for _ in range(2)])
    conductance = 1e-4 * 10 ** rng.uniform(-decades / 2, decades / 2, len(nodes))
    capacitance = 1e-12 * 10 ** rng.uniform(-decades / 2, decades / 2, n)
    caps = np.stack([np.arange(1, n + 1), np.zeros(n, dtype=int)], axis=1)
    netlist = rg.Netlist(n + 1, nodes, conductance, capacitor_nodes=caps, capacitance=capacitance)
    start = rng.normal(size=n)
    # Off-diagonals, and on the diagonal only what ties a node to ground.
    G = np.zeros((n + 1, n + 1))
    for (a, b), value in zip(nodes, conductance, strict=True):
        if a != b:
            G[a, b], G[b, a] = G[a, b] - value, G[b, a] - value
    G[np.diag_indices(n + 1)] = -G[:, 0]
    exact = ExactLags(G[1:, 1:], capacitance, start)
    with pytest.MonkeyPatch.context() as patch:
        if iterated:
            patch.setattr("resgrid.chip.time_constants.DENSE", 0)
        result = rg.study(netlist).settling(initial=np.append(0.0, start), span=1.0, modes=1)
    wanted = exact.settled(2.0**-11)
    assert result.node_time[1:] == pytest.approx(wanted, rel=2e-3, abs=1e-6 / exact.rate.max())
    assert result.time_constants[0] == pytest.approx(1 / exact.rate.min(), rel=1e-9)
    assert result.settle_time <= result.bound


def test_an_excursion_is_seen_however_short() -> None:
    """Node 2 begins at its end, follows node 1 out of the band, and is back a millionth of the time to settle later."""
    nodes = [[0, 1], [1, 2], [0, 2], [0, 3]]
    netlist = rg.Netlist(
        4, nodes, [1e-3, 1e-3, 1e-3, 1e-6], capacitor_nodes=[[1, 0], [2, 0], [3, 0]], capacitance=[1e-12, 1e-12, 1e-6]
    )
    result = rg.study(netlist).settling(initial=[0.0, 1.0, 0.0, 1.0], span=1.0)
    # V1 +- V2 fall as exp(-t / 1 ns) and exp(-3 t / 1 ns).
    assert result.node_time[2] == pytest.approx(1e-9 * np.log(2.0**10), rel=1e-5)
    assert result.node_time[3] == pytest.approx(1.0 * HALF_STEPS, rel=1e-9)


@pytest.mark.parametrize("volts", [1e-200, 1e-12, 1e12, 1e150])
def test_the_time_to_settle_does_not_depend_on_the_volts(volts: float) -> None:
    result = rg.study(two_lags(1e-9, 1e-9).replace(source_volts=[volts])).settling()
    assert result.settle_time == pytest.approx(1e-9 * HALF_STEPS, rel=1e-9)
    assert result.energy == pytest.approx(2e-12 * (1 - 2.0**-11) * volts**2, rel=1e-9)


@pytest.mark.parametrize("volts", [1e165, 1e300])
def test_energies_beyond_doubles_are_refused(volts: float) -> None:
    with pytest.raises(rg.AccuracyError, match="overflows"):
        rg.study(two_lags(1e-9, 1e-9).replace(source_volts=[volts])).settling()


@pytest.mark.parametrize("bad", ["6", float("nan"), np.array([4, 5]), 1.5, True, 0, -3])
@pytest.mark.parametrize("name", ["bits", "modes"])
def test_bits_and_modes_are_whole_numbers(name: str, bad: object) -> None:
    with pytest.raises(rg.InputError, match=name):
        rg.study(two_lags(1e-9, 1e-9)).settling(**{name: bad})


@pytest.mark.parametrize("bad", ["1", float("nan"), float("inf"), np.array([1.0, 2.0]), True, 0.0])
def test_a_span_is_a_positive_number(bad: object) -> None:
    with pytest.raises(rg.InputError, match="span"):
        rg.study(two_lags(1e-9, 1e-9)).settling(span=bad)  # type: ignore[arg-type]


def test_a_span_beside_which_nothing_settles_is_refused() -> None:
    with pytest.raises(rg.InputError, match="span"):
        rg.study(two_lags(1e-9, 1e-9).replace(source_volts=[1e150])).settling(span=1e-300)
