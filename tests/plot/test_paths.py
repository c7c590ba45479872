"""Pictures of paths, compared with their points, with breaks at seams; summary figures of every field.

Tests internals: `resgrid.plot.paths`.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_hex
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.plot.paths import seam_pieces


def lines_of(axes) -> dict[str, list[np.ndarray]]:
    return {c.get_label(): c.get_segments() for c in axes.collections if isinstance(c, LineCollection)}


def marks_of(axes) -> dict[str, np.ndarray]:
    return {c.get_label(): np.asarray(c.get_offsets()) for c in axes.collections if isinstance(c, PathCollection)}


def test_a_path_is_drawn_with_its_points_start_and_goal(field: rg.Field) -> None:
    path = rg.streamline(field, cell=(0, 4))
    axes = rg.draw(path)
    (line,) = lines_of(axes)["path"]
    assert np.allclose(line, path.points)
    assert np.allclose(marks_of(axes)["start"], path.points[:1])
    assert np.allclose(marks_of(axes)["goal reached"], path.points[-1:])


def test_paths_of_one_k_have_one_colour_and_one_legend_entry(field: rg.Field, neumann: rg.Field) -> None:
    paths = [rg.streamline(each, cell=cell) for each in (neumann, field) for cell in [(0, 4), (3, 2)]]
    axes = rg.draw(paths, k=[0.0, 0.0, 1.0, 1.0])
    assert {label: len(lines) for label, lines in lines_of(axes).items()} == {
        "$k$ = 0 (Neumann)": 2,
        "$k$ = 1 (Dirichlet)": 2,
    }
    assert len({tuple(c.get_colors()[0]) for c in axes.collections if isinstance(c, LineCollection)}) == 2
    assert len(marks_of(axes)["start"]) == 2
    with pytest.raises(rg.InputError, match="1 values of k for 4 paths"):
        rg.draw(paths, k=[1.0])


def test_line_widths_decrease_and_the_legend_is_in_order_of_k(field: rg.Field) -> None:
    paths = [rg.streamline(field, cell=(0, 4))] * 4
    axes = rg.draw(paths, k=[0.98, 0.0, 0.5, 1.0])
    lines = [c for c in axes.collections if isinstance(c, LineCollection)]
    widths = [float(line.get_linewidth()[0]) for line in lines]
    assert widths[0] > widths[1] > widths[2] >= widths[3]
    assert [to_hex(lines[n].get_colors()[0]) for n in (0, 3)] == ["#0072b2", "#e69f00"]  # as on the live page
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    named = [text for text in texts if text.startswith("$k$")]
    assert named == ["$k$ = 0 (Neumann)", "$k$ = 0.5", "$k$ = 0.98", "$k$ = 1 (Dirichlet)"]


def test_ends_at_a_small_goal_are_marked_at_its_centre() -> None:
    cell = np.zeros((180, 60), dtype=np.uint8)
    cell[40:42, 30] = rg.Cell.GOAL
    field = rg.field(rg.solve(rg.compile_space(space_of(cell))))
    paths = [rg.streamline(field, cell=cell) for cell in ((3, 5), (80, 50))]
    marks = marks_of(rg.draw(paths))
    np.testing.assert_allclose(marks["goal reached"], [[41.0, 30.5]])


def test_ends_of_many_paths_are_not_marked(field: rg.Field) -> None:
    paths = [rg.streamline(field, cell=cell) for cell in np.argwhere(field.space.goal_connected)]
    assert len(paths) > 12 and "goal reached" not in marks_of(rg.draw(paths))


def test_failed_starts_are_marked_with_their_outcome(field: rg.Field) -> None:
    paths = [rg.streamline(field, cell=cell) for cell in [(5, 3), (2, 2), (2, 1), (0, 0)]]
    marks = marks_of(rg.draw(paths))
    assert np.allclose(marks["no path (1 start)"], [field.space.centre((5, 3))])
    assert len(marks["start blocked (2 starts)"]) == 2
    assert len(marks["start"]) == 1


@pytest.mark.parametrize("cells", [2, 3, 9])
def test_lines_break_at_seams_and_keep_their_length(cells: int) -> None:
    """On a ring of any size no segment is longer than its cell, and the lengths of the pieces add up."""
    cell = np.zeros((cells, 6), dtype=np.uint8)
    cell[0, 0] = rg.Cell.GOAL
    if cells > 3:
        cell[3, :5] = rg.Cell.OBSTACLE
    ring = space_of(cell, periodic=(True, False))
    field = rg.field(rg.solve(rg.compile_space(ring, boundary="neumann")))
    crossed = 0
    for start in [(cells - 1 + 0.3, 4.6), (cells - 1 + 0.9, 5.2), (cells / 2 + 0.1, 5.5)]:
        path = rg.streamline(field, start=start)
        parts = seam_pieces(path)
        crossed += len(parts) - 1
        steps = [np.linalg.norm(np.diff(part, axis=0), axis=1) for part in parts]
        assert max(step.max() for step in steps) <= np.sqrt(2) + 1e-12
        assert sum(step.sum() for step in steps) == pytest.approx(path.length)
        for before, after in pairwise(parts):
            assert sorted([before[-1, 0], after[0, 0]]) == pytest.approx([0.0, float(cells)])
    assert crossed > 0


@pytest.mark.slow
def test_summary_panels_are_side_by_side_or_stacked(field: rg.Field) -> None:
    figure = rg.plot.draw_summary(field, [rg.streamline(field, cell=(0, 4))], title="Title")
    assert [axes.get_title() for axes in figure.axes[:2]] == ["Potential and paths", "Current"]
    assert figure.get_suptitle() == "Title"
    figure.canvas.draw()
    above, below = (axes.get_position() for axes in figure.axes[:2])
    assert above.y0 > below.y1  # 3.5 m x 1.25 m: wide, so stacked
    titles = [axes.title.get_window_extent() for axes in figure.axes[:2]]
    assert not titles[0].overlaps(titles[1])
    assert not figure._suptitle.get_window_extent().overlaps(titles[0])
    figure = rg.plot.draw_summary(rg.field(rg.solve(rg.compile_space(space_of(np.eye(4, dtype=int) * 2)))))
    figure.canvas.draw()
    left, right = (axes.get_position() for axes in figure.axes[:2])
    assert left.x1 < right.x0


def test_a_path_is_bold_only_within_its_slice(cube: rg.Field) -> None:
    path = rg.streamline(cube, cell=(0, 0, 0))
    labelled = [line for axes in rg.plot.draw_summary(cube, [path]).axes for line in axes.lines]
    bold = [line.get_xydata() for line in labelled if line.get_label() == "path in the slice"]
    assert len(bold) == 3  # one a slice: z = 3.5, y = 4.5, x = 5.5
    inside = path.points[path.points[:, 2] >= 3.0][:, :2]
    assert np.allclose(bold[0][~np.isnan(bold[0][:, 0])], inside)


def test_paths_of_other_spaces_raise_input_error(field: rg.Field, cube: rg.Field, line: rg.Field) -> None:
    for each, other in ((field, cube), (cube, line), (line, field)):
        path = rg.streamline(other, cell=(0,) * other.space.ndim)
        with pytest.raises(rg.InputError, match="coordinates, but the space"):
            rg.plot.draw_summary(each, [path])


@pytest.mark.slow
@settings(max_examples=12)
@given(spaces(), st.sampled_from(["dirichlet", "neumann", "wall"]), st.booleans())
def test_every_field_has_a_summary(space: rg.ConfigurationSpace, boundary: str, periodic: bool) -> None:
    """Random spaces: thin, tiny, without obstacles, with constant values."""
    assume(space.ndim < 4)
    axes = [replace(axis, periodic=periodic and number == 0) for number, axis in enumerate(space.axes)]
    space = rg.ConfigurationSpace(axes, space.cell, space.conductivity)
    options = {"wall_resistance": 1e4} if boundary == "wall" else {}
    try:
        field = rg.field(rg.solve(rg.compile_space(space, boundary=boundary, **options)))
    except rg.CircuitError:
        assume(False)
    paths = [rg.streamline(field, cell=cell) for cell in np.argwhere(space.cell != rg.Cell.GOAL)[::3].tolist()]
    figure = rg.plot.draw_summary(field, paths)
    figure.canvas.draw()
    assert figure.axes
