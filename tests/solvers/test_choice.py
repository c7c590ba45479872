"""The automatic choice of the method for checkerboards of conductivities.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers.method_choice`.
"""

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.circuit.equations import assemble
from resgrid.solvers.method_choice import choose_method


def checkerboard(size: int, block: int, decades: float) -> rg.ConfigurationSpace:
    """A checkerboard of blocks with conductivities `decades` orders of magnitude apart; the goal in a corner."""
    odd = (np.indices((size, size)) // block).sum(axis=0) % 2
    cell = np.zeros((size, size), dtype=np.uint8)
    cell[0, 0] = 2
    return space_of(cell, conductivity=10.0 ** (decades * (odd - 0.5)))


@pytest.mark.parametrize(("size", "block", "decades"), [(257, 16, 8.0), (256, 32, 10.0), (64, 16, 4.0)])
@pytest.mark.parametrize("accuracy", ["direction", "normwise"])
def test_planes_with_strong_contrast_are_solved_directly(size: int, block: int, decades: float, accuracy: str) -> None:
    for boundary in ("dirichlet", "neumann"):
        netlist = rg.compile_space(checkerboard(size, block, decades), boundary=boundary)
        point = rg.solve(netlist, accuracy=accuracy)
        assert point.method == "direct"
        assert point.backward_error < 1e-10


def test_planes_with_weak_contrast_are_solved_by_multigrid() -> None:
    for block, decades in ((16, 2.0), (1, 1.0)):
        system = assemble(rg.compile_space(checkerboard(300, block, decades)))
        assert (
            choose_method(system.laplacian).method
            == choose_method(system.laplacian, accuracy="normwise").method
            == "multigrid"
        )
