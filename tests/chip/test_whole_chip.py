"""All analyses of one chip with every effect, against ngspice and conservation laws.

Tests internals: `resgrid.spice.run.rawfile`, `resgrid.spice.write.flat`.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.dynamics import run_analysis, small_scene

import resgrid as rg
from resgrid.spice.run.rawfile import read_rawfile
from resgrid.spice.write.flat import flatten

CHIP = rg.Chip(
    capacitance=1e-12,
    mismatch=0.05,
    goal_switch_on=200.0,
    goal_switch_off=1e9,
    obstacle_switch_on=500.0,
    obstacle_switch_off=1e9,
    internodal_switch_on=300.0,
    rail_resistance=2.0,
    seed=3,
)


@pytest.fixture(scope="module")
def netlist() -> rg.Netlist:
    return rg.study(small_scene().cells.space, CHIP).netlist


@pytest.fixture(scope="module")
def op(netlist: rg.Netlist) -> rg.OperatingPoint:
    return rg.solve(netlist)


@pytest.mark.slow
def test_the_transient_agrees_with_ngspice_and_ends_at_the_operating_point(
    netlist: rg.Netlist, op: rg.OperatingPoint, tmp_path: Path
) -> None:
    slowest = float(rg.study(netlist).settling().time_constants[0])
    times = slowest * np.linspace(0.2, 3.0, 10)
    statements = f".options method=trap reltol=1e-5\n.tran {slowest / 150} {times[-1]} 0 {slowest / 150} uic"
    raw = run_analysis(flatten(netlist).text, statements, tmp_path)
    clock = raw.values[:, raw.names.index("time")]
    found = rg.circuit.transient(netlist, [*times, 1e3 * slowest])
    free = netlist.cells.free_node
    for node, name in zip(free.tolist(), netlist.names_of(free), strict=True):
        theirs = np.interp(times, clock, raw.values[:, raw.names.index(f"v({name})")])
        assert np.abs(theirs - found.voltage[:-1, node]).max() < 1e-3
    assert np.abs(found.voltage[-1] - op.voltage).max() < 1e-9


@pytest.mark.slow
def test_noise_agrees_with_ngspice(netlist: rg.Netlist, tmp_path: Path) -> None:
    """The spectrum is integrated here, because the integral of ngspice is NaN if a resistor contributes zero noise."""
    band = (1e3, 100 / (2 * np.pi * rg.study(netlist).settling().fastest))
    node = int(netlist.cells.node[3, 4])
    deck = re.sub(r"(?m)^(v_obstacle .*)$", r"\1 ac 1", flatten(netlist).text)
    control = f"noise v(n_3_4) v_obstacle dec 40 {band[0]!r} {band[1]!r}\nsetplot noise1\nwrite out.raw onoise_spectrum"
    (tmp_path / "noise.cir").write_text(deck.replace("\n.end\n", f"\n.control\n{control}\n.endc\n.end\n"))
    program = [shutil.which("ngspice"), "-n", "-b", "noise.cir"]
    subprocess.run(program, check=False, cwd=tmp_path, capture_output=True, timeout=300)
    frequency, density = read_rawfile((tmp_path / "out.raw").read_bytes()).values.T
    power = density**2 * frequency
    theirs = np.sqrt(np.sum((power[1:] + power[:-1]) / 2 * np.diff(np.log(frequency))))
    assert rg.study(netlist).noise(band=band).total[node] == pytest.approx(theirs, rel=1e-4)
    assert rg.study(netlist).noise_density([node], frequency)[:, 0] == pytest.approx(density**2, rel=1e-5)


def test_power_is_conserved_and_rails_droop(op: rg.OperatingPoint) -> None:
    power = rg.study(op).power()
    assert sum(rail.watts for rail in power.rails) == pytest.approx(power.total, rel=1e-9)
    assert {rail.name for rail in power.rails} == {"obstacle", "goal_0"}
    assert 0.001 < power.largest_droop < 0.2
    cell_map = op.netlist.cells
    goal = cell_map.node[11, 2]
    assert power.droop[goal] == pytest.approx(op.voltage[goal])


def test_following_is_the_neighbour_with_the_lowest_voltage(op: rg.OperatingPoint) -> None:
    cell_map = op.netlist.cells
    volts = op.voltage[cell_map.node]
    code = cell_map.space.cell
    result = rg.study(op).adc_resolution()
    for cell in map(tuple, np.argwhere(cell_map.space.goal_connected).tolist()):
        around = [(cell[0] + a, cell[1] + b) for a, b in ((-1, 0), (1, 0), (0, -1), (0, 1))]
        around = [p for p in around if min(p) >= 0 and max(p) < 16 and code[p] != 1]
        lowest = min(around, key=lambda p: volts[p])
        assert result.following[cell] == np.ravel_multi_index(lowest, code.shape)
        assert result.cell_bits[cell] == pytest.approx(np.log2(1 / (volts[cell] - volts[lowest])), abs=1e-6)


def test_sensitivity_includes_switches(op: rg.OperatingPoint) -> None:
    result = rg.study(op).sensitivity((8, 12))
    assert len(result.flip_drift) == len(op.netlist.conductance)
    switches = op.netlist.cells.resistor_face < 0
    assert np.isfinite(result.flip_drift[switches]).any()


def test_saturating_chips_are_analysed_by_their_small_signal_circuit() -> None:
    chip = rg.Chip(capacitance=1e-12, saturation_voltage=0.3)
    netlist = rg.study(small_scene().cells.space, chip).netlist
    op = rg.solve(netlist)
    assert np.isfinite(rg.study(op).adc_resolution().starts).all()
    assert rg.study(op).power().total == pytest.approx(op.power)
    assert np.isfinite(rg.study(op).sensitivity((8, 12)).flip_drift).any()
    small = rg.circuit.linearize(op)
    assert not len(small.nonlinear_current)
    assert rg.study(small).noise().resistance.max() > rg.study(small_scene()).noise().resistance.max()
    assert rg.study(small).settling().time_constants[0] > rg.study(small_scene()).settling().time_constants[0]
