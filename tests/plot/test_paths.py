from itertools import pairwise

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection

import resgrid as rg
from resgrid.compiler import compile_space
from resgrid.errors import InputError
from resgrid.nodal.solve import solve
from resgrid.planning.fields import Field
from resgrid.planning.trace import streamline
from resgrid.plot import plot_path, plot_streamlines
from resgrid.plot.paths import pieces
from resgrid.space import Axis, Cell, ConfigurationSpace


def lines_of(axes) -> dict[str, list[np.ndarray]]:
    return {c.get_label(): c.get_segments() for c in axes.collections if isinstance(c, LineCollection)}


def marks_of(axes) -> dict[str, np.ndarray]:
    return {c.get_label(): np.asarray(c.get_offsets()) for c in axes.collections if isinstance(c, PathCollection)}


def test_a_path_is_drawn_as_it_is(field: Field) -> None:
    path = streamline(field, cell=(0, 4))
    axes = plot_path(path, field.space)
    (line,) = lines_of(axes)["path"]
    assert np.allclose(line, path.points)
    assert np.allclose(marks_of(axes)["start"], path.points[:1])
    assert np.allclose(marks_of(axes)["goal reached"], path.points[-1:])


def test_paths_of_one_blend_share_a_colour(field: Field, neumann: Field) -> None:
    starts = [(0, 4), (3, 2)]
    paths = [streamline(each, cell=cell) for each in (neumann, field) for cell in starts]
    axes = plot_streamlines(paths, field.space, k=[0.0, 0.0, 1.0, 1.0])
    drawn = lines_of(axes)
    assert {label: len(lines) for label, lines in drawn.items()} == {
        "$k$ = 0 (Neumann)": 2,
        "$k$ = 1 (Dirichlet)": 2,
    }
    colours = {tuple(c.get_colors()[0]) for c in axes.collections if isinstance(c, LineCollection)}
    assert len(colours) == 2
    assert len(marks_of(axes)["start"]) == 2


def test_failures_are_crosses_that_name_their_outcome(field: Field) -> None:
    paths = [streamline(field, cell=cell) for cell in [(5, 3), (2, 2), (2, 1), (0, 0)]]
    marks = marks_of(plot_streamlines(paths, field.space))
    assert np.allclose(marks["no path (1 start)"], [field.space.centre((5, 3))])
    assert len(marks["start blocked (2 starts)"]) == 2
    assert len(marks["start"]) == 1


def test_k_must_match_the_paths(field: Field) -> None:
    with pytest.raises(InputError, match="1 values of k for 2 paths"):
        plot_streamlines([streamline(field, cell=(0, 0))] * 2, field.space, k=[1.0])


@pytest.mark.parametrize("cells", [2, 3, 9])
def test_lines_break_at_seams_and_keep_their_length(cells: int) -> None:
    """On a ring of any size no segment is longer than its cell, and the pieces add up to the path."""
    cell = np.zeros((cells, 6), dtype=np.uint8)
    cell[0, 0] = Cell.GOAL
    ring = ConfigurationSpace([Axis("a", 0.0, float(cells), cells, periodic=True), Axis("y", 0.0, 6.0, 6)], cell)
    if cells > 3:
        cell[3, :5] = Cell.OBSTACLE
        ring = ConfigurationSpace(ring.axes, cell)
    field = rg.field(solve(compile_space(ring, boundary="neumann")))
    crossed = 0
    for start in [(cells - 1 + 0.3, 4.6), (cells - 1 + 0.9, 5.2), (cells / 2 + 0.1, 5.5)]:
        path = streamline(field, start=start)
        parts = pieces(path, ring)
        crossed += len(parts) - 1
        steps = [np.linalg.norm(np.diff(part, axis=0), axis=1) for part in parts]
        assert max(step.max() for step in steps) <= np.sqrt(2) + 1e-12
        assert sum(step.sum() for step in steps) == pytest.approx(path.length)
        for before, after in pairwise(parts):
            assert sorted([before[-1, 0], after[0, 0]]) == pytest.approx([0.0, float(cells)])
    assert crossed > 0
    plot_path(path, ring)
