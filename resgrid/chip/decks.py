"""Writer of a chip's SPICE decks (operating point, transient, noise, temperature) with expected results.

The deck ``op``: the operating point.  ``transient``: the supplies of a discharged chip rise within one time step.
``noise``: the noise voltage at the noisiest cell.  ``temperature``: operating points at several temperatures.  In
``transient`` and ``noise``, a nonlinear chip is replaced by its linearization at the operating point.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.build import build_chip
from resgrid.chip.effects.values import Temperature
from resgrid.chip.figures_of_merit import defined
from resgrid.chip.noise import NOMINAL_KELVIN, analyse_noise
from resgrid.chip.settling import Settling
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.circuit.transients.linear import transient
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.scene.chip import Chip
from resgrid.spice.analyses import Analysis, NoiseAnalysis, Probe, TemperatureAnalysis, TransientAnalysis
from resgrid.spice.write.files import WrittenDeck, write_spice

CELSIUS = (-40.0, 27.0, 85.0, 125.0)
"""Temperatures of the operating points of the temperature deck, in degrees Celsius."""
BAND = 100.0
"""Upper limit of the noise band of a deck: the angular frequency times the chip's fastest time constant (no unit)."""

Words = dict[str, Any]
"""Keyword arguments ``title`` and ``dialect`` (name of the simulator's dialect) of `write_spice`, by name."""

_DESCRIPTIONS = {
    "op": "the chip, for its operating point",
    "transient": "the same chip, discharged, when its supplies are switched on",
    "noise": "the same chip, for the noise at its noisiest cell",
    "temperature": "the same chip with temperature coefficients, for several temperatures",
}
"""Descriptions of the decks for the list of written files, by the name of the deck."""
_POINTS = 20
"""Number of frequencies per decade of frequency in the noise analysis of a deck."""
_STEPS = 400
"""Number of time steps of the transient analysis of a deck."""
_MOMENTS = 10
"""Number of times of the transient analysis at which the sidecar states expected voltages."""
_MOST_PROBES = 1000
"""Largest number of nodes for which a deck records all node voltages."""
_FEW_PROBES = 64
"""Number of nodes whose voltages a deck records if the netlist has more than 1000 nodes (`_MOST_PROBES`)."""


def write_decks(
    op: OperatingPoint,
    linear: Netlist,
    settling: Settling | None,
    ideal: Netlist,
    chip: Chip,
    folder: Path,
    words: Words,
) -> dict[str, WrittenDeck]:
    """Write the SPICE decks of a chip; return the written decks by name.

    Names: ``op`` (operating point), ``transient`` and ``noise`` (only with `settling`), ``temperature``.

    `op`: operating point of the chip; `linear`: circuit of the chip, linearized at `op` if it is nonlinear; `settling`:
    Settling of `linear`, None for a chip without capacitances; `ideal`: circuit before the effects of the chip; `chip`:
    chip description; `folder`: existing folder; `words`: the arguments ``title`` and ``dialect`` of `write_spice`.
    """
    decks = {"op": write_spice(op, folder / "op.cir", **words)}
    if settling is not None:
        decks["transient"] = _transient(linear, settling, folder / "transient.cir", words)
        decks["noise"] = _noise(linear, settling, folder / "noise.cir", words)
    decks["temperature"] = _temperature(ideal, chip, folder / "temperature.cir", words)
    return decks


def described_files(decks: Mapping[str, WrittenDeck], dialect: str) -> dict[str, str]:
    """Return a description of every file of the decks, by file name.

    `decks`: written decks by name (``op``, ``transient``, ``noise``, ``temperature``); `dialect`: name of the
    simulator's dialect.
    """
    files = {}
    for name, deck in decks.items():
        files[deck.path.name] = _DESCRIPTIONS[name]
        files[deck.commands.name] = f"runs {deck.path.name} in {dialect}"
        files[deck.sidecar.name] = f"expected results of {deck.path.name}, and its nodes"
        if deck.companion is not None:
            files[deck.companion.name] = f"makes ngspice check the operating point of {deck.path.name}: PASS or FAIL"
    return files


def _transient(netlist: Netlist, settling: Settling, path: Path, words: Words) -> WrittenDeck:
    """Write the deck of the transient after the supplies are switched on to `path`; return the written deck.

    The sidecar states the expected voltages at ten times and at the end of settling, the slowest time constant, and the
    weights of the nodes in the slowest mode.  The expected voltages are those of an ideal switch-on in the middle of
    the simulator's first time step, in which the supplies rise.

    `netlist`: linear circuit; `settling`: Settling of `netlist`, which gives the time constants, the settling time, the
    final voltages and the slowest mode; `words`: the arguments ``title`` and ``dialect`` of `write_spice`, by name.
    """
    tau = float(settling.time_constants[0])
    stop = float(f"{max(1.1 * settling.settle_time, 6.0 * tau):.3g}")
    step = stop / _STEPS
    times = np.geomspace(stop / 50.0, stop, _MOMENTS)
    exact = transient(netlist, times - 0.5 * step)
    off = netlist.replace(
        source_volts=np.zeros(len(netlist.source_volts)), current_amps=np.zeros(len(netlist.current_amps))
    )
    nodes = _probed(netlist, settling.final)
    names = netlist.names_of(nodes)
    held = np.bincount(netlist.capacitor_nodes[:, 0], netlist.capacitance, netlist.node_count)
    weight = held * np.nan_to_num(settling.mode) / held.max()
    expected = {
        "definition": "voltages in volts at these times in seconds, counted from the beginning of the first time step, "
        "in which the supplies rise; final ones in volts; the slowest time constant in seconds: with these weights the "
        "sum of all distances from the final voltages falls as exp(-t / slowest_time_constant) exactly, where all "
        "cells are listed",
        "times": times.tolist(),
        "voltage": {name: exact.voltage[:, node].tolist() for name, node in zip(names, nodes, strict=True)},
        "final": {name: float(settling.final[node]) for name, node in zip(names, nodes, strict=True)},
        "slowest_time_constant": tau,
        "weight": {name: float(weight[node]) for name, node in zip(names, nodes, strict=True)},
    }
    analyses: list[Analysis] = [TransientAnalysis(stop, step, netlist), *_probe(netlist, nodes)]
    still = solve(off.replace(cell_map=None), accuracy="normwise")  # without cells, no drive is required
    rest = dataclasses.replace(still, netlist=off)
    return write_spice(rest, path, analyses=analyses, expected=expected, verify=False, **words)


def _noise(netlist: Netlist, settling: Settling, path: Path, words: Words) -> WrittenDeck:
    """Write the deck with the thermal noise voltage of the noisiest cell to `path`; return the written deck.

    The sidecar states the node, the band in hertz, and the expected noise: rms voltage within the band and over all
    frequencies, and density at low frequency.  `netlist`: linear circuit; `settling`: Settling of `netlist`, whose
    time constants determine the band; `words`: the arguments ``title`` and ``dialect`` of `write_spice`, by name.
    """
    band = noise_band(settling)
    noise = analyse_noise(netlist, band=band)
    assert noise.total is not None
    free = netlist.cells.free_node
    node = int(free[np.argmax(np.nan_to_num(noise.total)[free])])
    expected = {
        "definition": "root mean square of the noise voltage in volts at the node, from the first to the last "
        "frequency of the band in hertz, at the simulator's 27 degrees Celsius; density is that at low frequency in "
        "V/sqrt(Hz), limit the noise over all frequencies, sqrt(k T (C^-1)_ii) in volts (null where unbounded)",
        "node": netlist.node_name(node),
        "band": list(band),
        "temperature": NOMINAL_KELVIN,
        "total": float(noise.total[node]),
        "density": float(np.sqrt(noise.density[node])),
        "limit": defined(noise.limit[node]),
    }
    analyses = [NoiseAnalysis(netlist.node_name(node), *band, points=_POINTS)]
    return write_spice(netlist, path, analyses=analyses, expected=expected, **words)


def noise_band(settling: Settling) -> tuple[float, float]:
    """Return the lower and the upper limit of the noise band of a chip with capacitances, in hertz.

    The band reaches from 0.01 times the lowest to 100 times the highest corner frequency ``1 / (2 pi tau)``.  The
    upper limit is rounded up to a frequency point of the simulator, which computes 20 points per decade from the lower
    limit and stops at the last of them.  `settling`: gives the slowest and the fastest time constant ``tau``.
    """
    low = float(f"{0.01 / (2.0 * np.pi * float(settling.time_constants[0])):.3g}")
    points = int(np.ceil(_POINTS * np.log10(BAND / (2.0 * np.pi * settling.fastest * low))))
    return low, low * 10.0 ** (points / _POINTS)


def _temperature(ideal: Netlist, chip: Chip, path: Path, words: Words) -> WrittenDeck:
    """Write the deck of the operating points at several temperatures to `path`; return the written deck.

    The temperatures are -40, 27, 85 and 125 degrees Celsius (`CELSIUS`) and the temperature of the chip description.
    Temperatures at which a resistance would be negative or zero are left out.  The sidecar states the voltages at each
    temperature.  `ideal`: circuit before the effects of the chip; `chip`: chip description; `words`: the arguments
    ``title`` and ``dialect`` of `write_spice`, by name.
    """
    cold = build_chip(ideal, dataclasses.replace(chip, temperature=None))
    nodes = _probed(cold, solve(cold).voltage)
    own = () if chip.temperature is None else (chip.temperature,)
    voltages: dict[str, dict[str, float]] = {}
    for celsius in sorted({*CELSIUS, *own}):
        try:
            heated = Temperature(celsius).apply(cold)
        except InputError:  # the coefficients give a negative resistance
            continue
        volts = solve(heated).voltage
        voltages[repr(celsius)] = dict(zip(cold.names_of(nodes), volts[nodes].tolist(), strict=True))
    expected = {
        "definition": "voltages in volts by temperature in degrees Celsius; only resistors of the grid have "
        "temperature coefficients",
        "voltage": voltages,
    }
    analyses: list[Analysis] = [TemperatureAnalysis(tuple(map(float, voltages))), *_probe(cold, nodes)]
    return write_spice(cold, path, analyses=analyses, expected=expected, **words)


def _probed(netlist: Netlist, volts: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the numbers of the cell nodes whose expected voltages the sidecar of a deck states, shape (k,).

    These are all cell nodes if there are at most 1000, otherwise 64 of them, evenly spaced in the order of their
    numbers.  `volts` (nodes,): node voltages; nodes with NaN are left out.
    """
    cell_map = netlist.cells
    nodes = np.unique(cell_map.node[cell_map.node >= 0])
    nodes = nodes[np.isfinite(volts[nodes])]
    if len(nodes) <= _MOST_PROBES:
        return nodes
    return nodes[np.linspace(0, len(nodes) - 1, _FEW_PROBES).astype(np.int64)]


def _probe(netlist: Netlist, nodes: NDArray[np.int32]) -> list[Analysis]:
    """Return the list of analyses that restricts recording to `nodes`: one `Probe` with their names, or an empty list.

    The list is empty for a netlist of at most 1000 nodes, of which all voltages are recorded.
    """
    return [Probe(tuple(netlist.names_of(nodes)))] if netlist.node_count > _MOST_PROBES else []
