"""Voltages of random decks, compared with ngspice; ``RESGRID_RANDOM_DECKS`` is their number (default 40).

Tests internals: `resgrid.spice.read.deck`, `resgrid.spice.run.rawfile`.
"""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from support.decks import decks, random_deck, same

import resgrid as rg
from resgrid.spice.read.deck import read_with
from resgrid.spice.run.rawfile import read_rawfile

COUNT = int(os.environ.get("RESGRID_RANDOM_DECKS", "40"))


def simulated(folder: Path, seeds: range) -> list[dict[str, float]]:
    """Return the node voltages of random decks from one run of ngspice."""
    commands = ["* all", ".control"]
    for seed in seeds:
        (folder / f"d{seed}.cir").write_text(random_deck(seed))
        commands += [f"source d{seed}.cir", "op", f"write o{seed}.raw all", "remcirc"]
    (folder / "run.sp").write_text("\n".join([*commands, "quit", ".endc", ".end", ""]))
    subprocess.run(
        [os.environ.get("RESGRID_NGSPICE", "ngspice"), "-n", "-b", "run.sp"],
        cwd=folder,
        capture_output=True,
        timeout=300,
        check=False,
    )
    raws = [read_rawfile((folder / f"o{seed}.raw").read_bytes()) for seed in seeds]
    return [dict(zip(raw.names, raw.values[0].real.tolist(), strict=True)) for raw in raws]


def test_voltages_of_random_decks_equal_those_of_ngspice(tmp_path: Path) -> None:
    seeds = range(COUNT)
    for seed, expected in zip(seeds, simulated(tmp_path, seeds), strict=True):
        deck = read_with(tmp_path / f"d{seed}.cir")
        voltage = rg.solve(deck.netlist(), accuracy="normwise", rtol=1e-12).voltage
        names = [name.lower() for name in deck.node_names[1:]]
        simulation = np.array([expected.get(name, expected.get(f"v({name})", np.nan)) for name in names])
        error = np.max(np.abs(voltage[1:] - simulation))
        assert error <= 1e-9 * np.max(np.abs(voltage)), (seed, error)


@pytest.mark.slow
@given(decks())
@settings(max_examples=60)
def test_the_fast_reader_agrees_with_the_general_reader(tmp_path_factory, deck: str) -> None:
    path = tmp_path_factory.mktemp("deck") / "deck.cir"
    path.write_text(deck)
    assert same(read_with(path, least_bytes=10**9), read_with(path, least_bytes=0))
