"""Circuits with capacitors, exact transients by a dense generalised eigenproblem, and reference runs of ngspice.

This module shares no code with the dynamics of the package.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

import resgrid as rg
from resgrid.spice.run.rawfile import RawFile, read_rawfile
from support.circuits import random_grid
from support.spaces import space_of


def with_capacitors(netlist: rg.Netlist, farads: float) -> rg.Netlist:
    """Return a compiled netlist with equal capacitors from all free cells to ground."""
    free = netlist.cells.free_node
    pairs = np.stack([free, np.zeros_like(free)], axis=1)
    return netlist.replace(capacitor_nodes=pairs, capacitance=np.full(len(free), farads))


def small_scene(farads: float = 1e-12, **options: object) -> rg.Netlist:
    """Return 16 x 16 cells with three walls and a goal; 10 kohm and 1 pF."""
    cell = np.zeros((16, 16), dtype=np.uint8)
    cell[4:9, 7] = cell[10:12, 10:13] = cell[13, 0:4] = 1
    cell[11, 2] = 2
    return with_capacitors(rg.compile_space(space_of(cell), **options), farads)  # type: ignore[arg-type]


def random_dynamics(seed: int, side: int = 5, decades: float = 1.0) -> rg.Netlist:
    """Return a random grid with capacitors to ground, to a rail and between cells; some cells have no capacitor."""
    netlist = random_grid(seed, side, decades)
    rng = np.random.default_rng(seed + 1)
    grid = np.arange(4, netlist.node_count)
    own = grid[rng.random(len(grid)) < 0.6]
    to_rail = grid[rng.random(len(grid)) < 0.2]
    inner = netlist.resistor_nodes[(netlist.resistor_nodes >= 4).all(axis=1)]
    across = inner[rng.random(len(inner)) < 0.15]
    pairs = np.concatenate([np.stack([own, 0 * own], axis=1), np.stack([to_rail, 0 * to_rail + 1], axis=1), across])
    return netlist.replace(capacitor_nodes=pairs, capacitance=1e-12 * 10 ** rng.uniform(-0.5, 0.5, len(pairs)))


class ExactMotion:
    """Exact transient of a netlist with grounded voltage sources, by eigenvectors of ``C v = mu G v``."""

    def __init__(self, netlist: rg.Netlist, before: NDArray[np.float64] | None = None) -> None:
        n = netlist.node_count
        G, C, b, known = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.full(n, np.nan)
        known[0] = 0.0
        for (plus, minus), volts in zip(netlist.source_nodes, netlist.source_volts, strict=True):
            known[plus if minus == 0 else minus] = volts if minus == 0 else -volts
        for matrix, pairs, values in (
            (G, netlist.resistor_nodes, netlist.conductance),
            (C, netlist.capacitor_nodes, netlist.capacitance),
        ):
            for (i, j), value in zip(pairs, values, strict=True):
                matrix[[i, j], [i, j]] += value
                matrix[[i, j], [j, i]] -= value
        for (i, j), amps in zip(netlist.current_nodes, netlist.current_amps, strict=True):
            b[i] -= amps
            b[j] += amps
        self.free, self.known = np.isnan(known), known
        free, held = self.free, ~self.free
        self.G, self.C = G[np.ix_(free, free)], C[np.ix_(free, free)]
        self.final = np.linalg.solve(self.G, b[free] - G[np.ix_(free, held)] @ known[held])
        charge = (C @ (np.zeros(n) if before is None else before))[free] - C[np.ix_(free, held)] @ known[held]
        mu, self.vectors = eigh(self.C, self.G)
        self.tau = np.where(mu > 1e-12 * mu.max(), mu, 0.0)
        weight = self.vectors.T @ (charge - self.C @ self.final)
        self.weight = np.divide(weight, self.tau, out=np.zeros_like(weight), where=self.tau > 0)

    def voltage(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        live = self.tau > 0
        decay = np.exp(-np.asarray(times)[:, None] / self.tau[live])
        result = np.tile(self.known, (len(times), 1))
        result[:, self.free] = self.final + (decay * self.weight[live]) @ self.vectors[:, live].T
        return result


def run_analysis(deck: str, statements: str, folder: Path) -> RawFile:
    """Run ngspice on a deck with additional statements before its end, and read the single plot."""
    program = shutil.which("ngspice")
    assert program is not None
    text = re.sub(r"\n\.end\s*$", f"\n{statements}\n.end\n", deck)
    (folder / "deck.cir").write_text(text, encoding="ascii")
    subprocess.run(
        [program, "-n", "-b", "-r", "out.raw", "deck.cir"], cwd=folder, check=True, capture_output=True, timeout=300
    )
    return read_rawfile((folder / "out.raw").read_bytes())
