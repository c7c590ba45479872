"""Published decks and networks (OpenROAD, ICCAD 2023, Circuitscape), compared with their published results.

Tests internals: `resgrid.spice.networks.circuitscape`, `resgrid.spice.read.deck`.
"""

import csv
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import resgrid as rg
from resgrid.spice.networks.circuitscape import read_circuitscape
from resgrid.spice.read.deck import read_with


def test_an_openroad_ground_net_has_the_published_voltages(cases: Path) -> None:
    path = cases / "openroad" / "gcd_all_vss.sp"
    deck = rg.read_spice(path)
    assert (len(deck.resistance), len(deck.current_amps), len(deck.source_volts)) == (3371, 510, 3)
    voltage = dict(zip(deck.node_names, rg.solve(deck.netlist(), accuracy="normwise").voltage.tolist(), strict=True))
    sink, lines = {}, path.read_text().splitlines()
    for comment, card in pairwise(lines):
        if comment.startswith("* Sink for "):
            sink[comment.split()[3]] = card.split()[1]
    with (path.parent / "gcd_all_vss-voltage.csv").open() as table:
        rows = {f"{row['Instance']}/{row['Terminal']}": float(row["Voltage"]) for row in csv.DictReader(table)}
    error = [abs(voltage[node] + rows[name]) for name, node in sink.items()]
    assert len(error) == 510
    assert max(error) < 1e-6


@pytest.mark.parametrize("least", [0, pytest.param(10**9, marks=pytest.mark.slow)])
def test_an_iccad_power_grid_without_title_has_the_published_drops(cases: Path, least: int) -> None:
    folder = cases / "iccad23" / "testcase11"
    deck = read_with(folder / "netlist.sp", least_bytes=least)
    assert deck.title is None
    assert deck.element_names["resistor"][0] == "R0"
    assert any("no title line" in note.text for note in deck.notes)
    voltage = rg.solve(deck.netlist(), accuracy="normwise").voltage
    drop = np.loadtxt(folder / "ir_drop_map.csv", delimiter=",")
    supply = deck.source_volts.max()
    places = [name.split("_") for name in deck.node_names]
    found = [
        (int(parts[2]) // 2000, int(parts[3]) // 2000, supply - volts)
        for parts, volts in zip(places, voltage, strict=True)
        if len(parts) == 4 and parts[1] == "m1"
    ]
    differences = [abs(drop[x, y] - fall) for x, y, fall in found if x < drop.shape[0] and y < drop.shape[1]]
    assert len(differences) > 5000
    assert np.median(differences) < 2e-5


@pytest.mark.parametrize("number", [1, 2])
def test_circuitscape_networks_have_the_published_voltages(cases: Path, number: int) -> None:
    folder = cases / "circuitscape"
    netlist = rg.read_spice(folder / f"mgNetworkVerify{number}.ini").netlist()
    assert netlist.node_names is not None
    voltage = dict(zip(netlist.node_names, rg.solve(netlist).voltage.tolist(), strict=True))
    expected = dict(
        line.split() for line in (folder / f"mgNetworkVerify{number}_voltages.txt").read_text().splitlines()
    )
    assert max(abs(voltage[name] - float(volts)) for name, volts in expected.items()) < 1e-8


# the maps were computed by conjugate gradients: their currents have errors of 5e-7 of a source
@pytest.mark.parametrize(("number", "error"), [(2, 1e-7), (5, 1e-7)])
def test_circuitscape_rasters_have_the_published_voltages(cases: Path, number: int, error: float) -> None:
    folder = cases / "circuitscape" / f"raster{number}"
    network, node = read_circuitscape(folder / f"mgVerify{number}.ini")
    assert node is not None
    voltage = rg.solve(network.netlist()).voltage
    found = np.where(node >= 0, voltage[node], 0.0)
    expected = np.loadtxt(folder / f"mgVerify{number}_voltmap.asc", skiprows=6)
    assert np.max(np.abs(found - expected)) < error * np.max(np.abs(expected))
