from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from dynamics import ExactMotion, random_dynamics, run_analysis, small_scene
from hypothesis import given, settings, strategies as st

import resgrid as rg
from resgrid.device.noise import BOLTZMANN, ROOM, analyse_noise, noise_covariance, noise_density
from resgrid.device.spectrum import fastest_time_constant
from resgrid.nodal.dynamics import dynamics_of


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
    result = analyse_noise(netlist, band=band)
    assert result.exact
    assert result.total[exact.free] ** 2 == pytest.approx(exact_power(exact, *band), rel=1e-5)
    assert result.resistance[exact.free] == pytest.approx(np.diag(np.linalg.inv(exact.G)), rel=1e-9)
    assert not result.total[~exact.free].any()


def test_a_picofarad_gives_64_microvolt() -> None:
    netlist = small_scene()
    free = netlist.layout.free_node
    band = (0.0, 100 / (2 * np.pi * fastest_time_constant(dynamics_of(netlist))))
    result = analyse_noise(netlist, band=band)
    assert result.limit[free] == pytest.approx(6.437e-5, rel=1e-3)
    assert result.total[free] == pytest.approx(result.limit[free], rel=0.01)
    assert (result.total[free] < result.limit[free]).all()
    covariance = noise_covariance(netlist, free[:3])
    assert covariance == pytest.approx(np.eye(3) * BOLTZMANN * ROOM / 1e-12)


def test_ngspice_integrates_the_same_noise(tmp_path: Path) -> None:
    netlist = small_scene()
    node = int(netlist.layout.node[3, 4])
    low, high = 1e3, 100 / (2 * np.pi * fastest_time_constant(dynamics_of(netlist)))
    control = f".control\nnoise v(n_3_4) v_obstacle dec 40 {low!r} {high!r}\nsetplot noise2\nprint onoise_total\n.endc"
    deck = rg.format_deck(netlist).replace("\n.end\n", f"\n{control}\n.end\n")
    deck = re.sub(r"(?m)^(v_obstacle .*)$", r"\1 ac 1", deck)
    (tmp_path / "noise.cir").write_text(deck)
    said = subprocess.run(
        [shutil.which("ngspice"), "-n", "-b", "noise.cir"],
        cwd=tmp_path,
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    ).stdout
    theirs = float(re.search(r"onoise_total = (\S+)", said).group(1))
    assert analyse_noise(netlist, band=(low, high)).total[node] == pytest.approx(theirs, rel=0.01)


def test_ngspice_shows_the_same_spot_density(tmp_path: Path) -> None:
    netlist = random_dynamics(2)
    statements = ".ac dec 1 1e5 1e11\ni_probe 0 node_9 dc 0 ac 1"
    raw = run_analysis(rg.format_deck(netlist), statements, tmp_path)
    frequency = raw.values[:, raw.names.index("frequency")].real
    impedance = raw.values[:, raw.names.index("v(node_9)")].real
    found = noise_density(netlist, [9], frequency)
    assert found[:, 0] == pytest.approx(4 * BOLTZMANN * ROOM * impedance, rel=1e-6)


def test_an_estimate_lies_within_its_error_bars() -> None:
    netlist = small_scene()
    free = netlist.layout.free_node
    band = (0.0, 1e8)
    exact, found = (analyse_noise(netlist, band=band, method=name, samples=100) for name in ("exact", "estimate"))
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
    result = analyse_noise(netlist)
    assert result.total is None
    free = np.flatnonzero(np.isfinite(result.resistance) & (result.resistance > 0))
    assert np.isinf(result.limit[free[~bare]]).all()
    with pytest.raises(rg.InputError, match="unbounded"):
        noise_covariance(netlist, free[~bare][:1])


def test_covariance_of_coupled_capacitors() -> None:
    netlist = rg.Netlist(
        3, [[1, 0], [2, 0]], [1.0, 1.0], capacitor_nodes=[[1, 0], [1, 2], [2, 0]], capacitance=[1e-12, 2e-12, 3e-12]
    )
    wanted = np.linalg.inv([[3e-12, -2e-12], [-2e-12, 5e-12]]) * BOLTZMANN * ROOM
    assert noise_covariance(netlist, [1, 2]) == pytest.approx(wanted)
    assert analyse_noise(netlist).limit[1:] == pytest.approx(np.sqrt(np.diag(wanted)))


def test_readings_state_the_limits_of_the_integral() -> None:
    data = analyse_noise(small_scene(), band=(0.0, 1e6)).to_json()
    assert data["band"] == [0.0, 1e6]
    assert "from 0 Hz to 1e+06 Hz" in data["largest_noise"]["definition"]
    assert data["largest_noise"]["unit"] == "V"


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"band": (1.0, 1.0)}, "lower first"),
        ({"band": (0.0, np.inf)}, "limit"),
        ({"temperature": 0.0}, "kelvin"),
        ({"method": "guess"}, "exact"),
        ({"samples": 1}, "error bar"),
    ],
)
def test_bad_arguments_are_named(options: dict[str, object], word: str) -> None:
    with pytest.raises(rg.InputError, match=word):
        analyse_noise(small_scene(), **options)


def test_nodes_and_frequencies_are_checked() -> None:
    with pytest.raises(rg.InputError, match="node numbers"):
        noise_density(small_scene(), [10**6], [1.0])
    with pytest.raises(rg.InputError, match="frequencies"):
        noise_density(small_scene(), [5], [-1.0])
