"""Tests internals: `resgrid.chip.noise`, `resgrid.chip.time_constants`, `resgrid.circuit.dynamics`,
`resgrid.spice.write.flat`."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.dynamics import ExactMotion, random_dynamics, run_analysis, small_scene

import resgrid as rg
from resgrid.chip.noise import BOLTZMANN, ROOM
from resgrid.chip.time_constants import fastest_time_constant
from resgrid.circuit.dynamics import dynamics_of
from resgrid.spice.write.flat import flatten


def exact_power(exact: ExactMotion, low: float, high: float) -> np.ndarray:
    """Mean square noise of the free nodes from the eigenvectors, in V^2."""
    w = 2 * np.pi * exact.tau
    slow = w > 0
    area = np.full(len(w), high - low)
    area[slow] = (np.arctan(high * w[slow]) - np.arctan(low * w[slow])) / w[slow]
    return 4 * BOLTZMANN * ROOM * (exact.vectors**2 @ area)


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), low=st.sampled_from([0.0, 1e3, 1e7]), decades=st.floats(0.1, 6))
def test_noise_of_random_circuits_within_a_band(seed: int, low: float, decades: float) -> None:
    netlist = random_dynamics(seed)
    exact = ExactMotion(netlist)
    band = (low, max(low, 1e4) * 10**decades)
    result = rg.study(netlist).noise(band=band)
    assert result.exact
    assert result.total[exact.free] ** 2 == pytest.approx(exact_power(exact, *band), rel=1e-5)
    assert result.resistance[exact.free] == pytest.approx(np.diag(np.linalg.inv(exact.G)), rel=1e-9)
    assert not result.total[~exact.free].any()


def test_a_picofarad_gives_64_microvolt() -> None:
    netlist = small_scene()
    free = netlist.cells.free_node
    band = (0.0, 100 / (2 * np.pi * fastest_time_constant(dynamics_of(netlist))))
    result = rg.study(netlist).noise(band=band)
    assert result.limit[free] == pytest.approx(6.437e-5, rel=1e-3)
    assert result.total[free] == pytest.approx(result.limit[free], rel=0.01)
    assert (result.total[free] < result.limit[free]).all()
    covariance = rg.study(netlist).noise_covariance(free[:3])
    assert covariance == pytest.approx(np.eye(3) * BOLTZMANN * ROOM / 1e-12)


def test_ngspice_integrates_the_same_noise(tmp_path: Path) -> None:
    netlist = small_scene()
    node = int(netlist.cells.node[3, 4])
    low, high = 1e3, 100 / (2 * np.pi * fastest_time_constant(dynamics_of(netlist)))
    control = f".control\nnoise v(n_3_4) v_obstacle dec 40 {low!r} {high!r}\nsetplot noise2\nprint onoise_total\n.endc"
    deck = flatten(netlist).text.replace("\n.end\n", f"\n{control}\n.end\n")
    deck = re.sub(r"(?m)^(v_obstacle .*)$", r"\1 ac 1", deck)
    (tmp_path / "noise.cir").write_text(deck)
    said = subprocess.run(
        [shutil.which("ngspice"), "-n", "-b", "noise.cir"],
        cwd=tmp_path,
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
    ).stdout
    theirs = float(re.search(r"onoise_total = (\S+)", said).group(1))
    assert rg.study(netlist).noise(band=(low, high)).total[node] == pytest.approx(theirs, rel=0.01)


def test_ngspice_shows_the_same_spot_density(tmp_path: Path) -> None:
    netlist = random_dynamics(2)
    statements = ".ac dec 1 1e5 1e11\ni_probe 0 node_9 dc 0 ac 1"
    raw = run_analysis(flatten(netlist).text, statements, tmp_path)
    frequency = raw.values[:, raw.names.index("frequency")].real
    impedance = raw.values[:, raw.names.index("v(node_9)")].real
    found = rg.study(netlist).noise_density([9], frequency)
    assert found[:, 0] == pytest.approx(4 * BOLTZMANN * ROOM * impedance, rel=1e-6)


def test_an_estimate_lies_within_its_error_bars() -> None:
    netlist = small_scene()
    free = netlist.cells.free_node
    band = (0.0, 1e8)
    exact, found = (rg.study(netlist).noise(band=band, method=name, samples=100) for name in ("exact", "estimate"))
    assert not found.exact
    for name in ("total", "resistance"):
        error = np.abs(getattr(found, name) - getattr(exact, name))[free]
        bar = getattr(found, f"{name}_error")[free]
        assert (bar > 0).all()
        assert 0.5 < np.mean(error < bar) < 0.85
        assert np.mean(error < 3 * bar) > 0.97


def test_without_capacitance_the_noise_is_unbounded() -> None:
    netlist = random_dynamics(9)
    bare = ExactMotion(netlist).C.any(axis=1)
    result = rg.study(netlist).noise()
    assert result.total is None
    free = np.flatnonzero(np.isfinite(result.resistance) & (result.resistance > 0))
    assert np.isinf(result.limit[free[~bare]]).all()
    with pytest.raises(rg.InputError, match="unbounded"):
        rg.study(netlist).noise_covariance(free[~bare][:1])


def test_covariance_of_coupled_capacitors() -> None:
    netlist = rg.Netlist(
        3, [[1, 0], [2, 0]], [1.0, 1.0], capacitor_nodes=[[1, 0], [1, 2], [2, 0]], capacitance=[1e-12, 2e-12, 3e-12]
    )
    wanted = np.linalg.inv([[3e-12, -2e-12], [-2e-12, 5e-12]]) * BOLTZMANN * ROOM
    assert rg.study(netlist).noise_covariance([1, 2]) == pytest.approx(wanted)
    assert rg.study(netlist).noise().limit[1:] == pytest.approx(np.sqrt(np.diag(wanted)))


def test_readings_state_the_limits_of_the_integral() -> None:
    data = rg.study(small_scene()).noise(band=(0.0, 1e6)).to_json()
    assert data["band"] == [0.0, 1e6]
    assert "from 0 Hz to 1e+06 Hz" in data["largest_noise"]["definition"]
    assert data["largest_noise"]["unit"] == "V"


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"band": (1.0, 1.0)}, "lower first"),
        ({"band": (0.0, np.inf)}, "limit"),
        ({"temperature": 0.0}, "temperature = 0.0 must be .* above 0"),
        ({"method": "guess"}, "exact"),
        ({"samples": 1}, "at least 2"),
        ({"samples": 2.5}, "samples = 2.5"),
        ({"samples": "x"}, "samples = 'x'"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": None}, "seed = None"),
        ({"temperature": "x"}, "temperature = 'x'"),
        ({"temperature": True}, "temperature = True"),
        ({"band": 5}, "band = 5"),
        ({"band": "ab"}, "band = 'ab'"),
        ({"band": (None, 1.0)}, "finite number"),
        ({"band": np.array([[0.0, 1.0], [2.0, 3.0]])}, "finite number"),
        ({"method": None}, "method = None"),
    ],
)
def test_bad_arguments_are_named(options: dict[str, object], word: str) -> None:
    with pytest.raises(rg.InputError, match=word):
        rg.study(small_scene()).noise(**options)


@pytest.mark.parametrize("nodes", [[10**6], [-2], [1.9], [[1]], [True], "x", [2**63], [2**70], [1, [2]], None], ids=str)
def test_nodes_are_checked(nodes: object) -> None:
    with pytest.raises(rg.InputError, match=r"node numbers|nodes = .* must be numbers"):
        rg.study(small_scene()).noise_density(nodes, [1.0])
    with pytest.raises(rg.InputError, match=r"node numbers|nodes = .* must be numbers"):
        rg.study(small_scene()).noise_covariance(nodes)


@pytest.mark.parametrize("frequencies", [[-1.0], [[1.0]], [1j], "x", None, [np.inf], [1e308], [1.0, [2.0]]], ids=str)
def test_frequencies_are_checked(frequencies: object) -> None:
    with pytest.raises(rg.InputError, match="frequencies"):
        rg.study(small_scene()).noise_density([5], frequencies)


def three_nodes(resistors: list[float], tie: float = 0.0) -> rg.Netlist:
    """Three nodes in a ring (or a chain) of resistors, 1 pF from each to ground, and a conductance from the last."""
    pairs = [[1, 2], [2, 3], [3, 1]][: len(resistors)]
    return rg.Netlist(
        4,
        [*pairs, [3, 0]] if tie else pairs,
        [1 / r for r in resistors] + ([tie] if tie else []),
        capacitor_nodes=[[1, 0], [2, 0], [3, 0]],
        capacitance=[1e-12] * 3,
    )


@pytest.mark.parametrize("frequency", [1e9, 1e6, 1.0, 1e-2, 1e-6, 1e-12])
@pytest.mark.parametrize(("tie", "resistors"), [(0.0, [1e4, 1e4]), (0.0, [3.0, 7.0, 11.0]), (1e-17, [3.0, 7.0, 11.0])])
def test_spot_density_where_capacitors_alone_hold_a_part(frequency: float, tie: float, resistors: list[float]) -> None:
    netlist = three_nodes(resistors, tie)
    with mp.workdps(60):
        Y = mp.eye(3) * mp.mpc(0, 2 * mp.pi * frequency * mp.mpf(1e-12))
        for (a, b), g in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
            Y[a - 1, a - 1] += g
            if b:
                Y[b - 1, b - 1] += g
                Y[a - 1, b - 1] -= g
                Y[b - 1, a - 1] -= g
        Z = Y**-1
        wanted = [float(mp.re(Z[i, i])) for i in range(3)]
    found = rg.study(netlist).noise_density([1, 2, 3], [frequency])[0] / (4 * BOLTZMANN * ROOM)
    assert found == pytest.approx(wanted, rel=1e-9)


def test_at_0_hertz_a_part_without_resistors_to_a_rail_has_no_density() -> None:
    with pytest.raises(rg.CircuitError, match="node_1 is tied to no rail"):
        rg.study(three_nodes([1e4, 3e4])).noise_density([1, 2, 3], [0.0])


def test_a_density_that_doubles_cannot_tell_is_refused() -> None:
    """Two stiff pairs whose middle tie is weak: neither pair is a part of its own."""
    netlist = rg.Netlist(
        5, [[1, 2], [2, 3], [3, 4], [1, 0]], [1e12, 1e-12, 1e12, 1.0], capacitor_nodes=[[4, 0]], capacitance=[1e-12]
    )
    found = rg.study(netlist).noise_density([1, 2, 3, 4], [0.0])[0] / (4 * BOLTZMANN * ROOM)
    assert found == pytest.approx([1.0, 1.0, 1e12, 1e12], rel=1e-9)
    for nodes in ([4], [1, 4]):
        with pytest.raises(rg.AccuracyError, match="too many orders of magnitude"):
            rg.study(netlist).noise_density(nodes, [1e-3])


@pytest.mark.parametrize("tie", [1e-3, 1e-12, 1e-15, 1e-17, 1e-25])
def test_weakly_tied_parts_have_their_effective_resistance(tie: float) -> None:
    result = rg.study(three_nodes([3.0, 7.0, 11.0], tie)).noise()
    across = [1 / (1 / 11 + 1 / 10), 1 / (1 / 7 + 1 / 14), 0.0]
    assert result.resistance[1:] == pytest.approx(1 / tie + np.array(across), rel=1e-14)
    assert result.exact
    assert not result.resistance_error.any()


def test_a_band_that_rounding_spoils_is_refused() -> None:
    for method in ("exact", "estimate"):
        with pytest.raises(rg.AccuracyError, match="rounding may change"):
            rg.study(three_nodes([3.0, 7.0, 11.0], 1e-17)).noise(band=(0.0, 1.0), method=method)


@pytest.mark.parametrize("high", [1e-4, 1e-3, 9e-3, 1.1e-2, 0.1, 1.0, 100.0])
@pytest.mark.parametrize("low", [0.0, 1e-5, 5e-3])
def test_the_noise_of_one_capacitor_is_an_arc_tangent(low: float, high: float) -> None:
    netlist = rg.Netlist(2, [[1, 0]], [1e-4], capacitor_nodes=[[1, 0]], capacitance=[1e-12])
    if high <= low:
        return
    corner = 1 / (2 * np.pi * 1e-8)
    wanted = 4 * BOLTZMANN * ROOM * 1e4 * corner * (np.arctan(high) - np.arctan(low))
    found = rg.study(netlist).noise(band=(low * corner, high * corner))
    assert found.total[1] ** 2 == pytest.approx(wanted, rel=1e-8)
    assert 0 < found.total_error[1] < 1e-14 * found.total[1]


def test_covariance_of_floating_nodes_is_unknown_and_of_rails_none() -> None:
    netlist = rg.Netlist(4, [[1, 0], [2, 0]], [1.0, 1.0], capacitor_nodes=[[1, 0], [2, 0]], capacitance=[1e-12, 4e-12])
    found = rg.study(netlist).noise_covariance([0, 1, 3])
    wanted = np.diag([0.0, BOLTZMANN * ROOM / 1e-12, np.nan])
    wanted[2] = wanted[:, 2] = np.nan
    assert found == pytest.approx(wanted, nan_ok=True)


def test_where_the_rails_hold_every_node_nothing_is_noisy() -> None:
    netlist = rg.Netlist(2, [[1, 0]], [1.0], [[1, 0]], [1.0])
    for method in ("exact", "estimate"):
        result = rg.study(netlist).noise(method=method, band=(0.0, 1.0))
        assert not result.resistance.any()
        assert not result.total.any()
