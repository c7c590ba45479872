"""The lesson on resistor grids: its code cells run, its pictures show its numbers, and the answers are correct."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from support.shown import PROJECT, pieces_of_markdown

import resgrid as rg

PAGE = PROJECT / "docs" / "explanation" / "why_it_plans.md"
TEXT = PAGE.read_text(encoding="utf-8")


class Lesson:
    """The executed page: names of its cells, printed text and pictures."""

    def __init__(self) -> None:
        self.names: dict[str, Any] = {}
        self.figures: list[Figure] = []
        printed = io.StringIO()
        with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
            patch.chdir(PROJECT)
            patch.setattr(plt, "show", self._keep)
            for piece in pieces_of_markdown(TEXT, str(PAGE)):
                if piece.kind == "python":
                    exec(compile(piece.text, str(PAGE), "exec"), self.names)
        self.printed = printed.getvalue()

    def _keep(self) -> None:
        self.figures += map(plt.figure, plt.get_fignums())
        plt.close("all")


@pytest.fixture(scope="module")
def lesson() -> Iterator[Lesson]:
    """The executed page."""
    before = plt.get_backend()
    plt.switch_backend("agg")
    yield Lesson()
    plt.close("all")
    plt.switch_backend(before)


def test_the_page_has_five_pictures_with_legible_labels(lesson: Lesson) -> None:
    assert len(lesson.figures) == 5
    for figure in lesson.figures:
        figure.canvas.draw()
        written = [text for text in figure.findobj(plt.Text) if text.get_text()]
        assert written and min(text.get_fontsize() for text in written) >= 8


def test_colours_of_all_pictures_mean_the_height_above_the_goal(lesson: Lesson) -> None:
    own = rg.draw(lesson.names["field"], scale="linear").images[0].cmap
    images = [image for figure in lesson.figures for axes in figure.axes for image in axes.images]
    assert len(images) == 3 and all(image.cmap == own for image in images)
    scattered = lesson.figures[4].axes[0].collections[-1]
    assert scattered.cmap == own and scattered.get_clim() == (0.0, 1.0)


def test_numbers_of_the_first_two_pictures_obey_ohm_and_kirchhoff(lesson: Lesson) -> None:
    for figure in lesson.figures[:2]:
        words = [text.get_text() for text in figure.axes[0].texts]
        volts = [float(word[:-2]) for word in words if word.endswith(" V")]
        amperes = [float(word[:-3]) for word in words if word.endswith(" µA")]
        assert len(amperes) == len(volts) - 1
        if len(volts) == 2:
            assert amperes[0] == pytest.approx(100 * (volts[0] - volts[1]), abs=0.1)  # µA with 10 kΩ
        else:
            *around, middle = volts
            assert middle == pytest.approx(np.mean(around), abs=1e-3)
            assert amperes == pytest.approx([100 * abs(value - middle) for value in around], abs=0.1)
            assert 2 * max(amperes) == pytest.approx(sum(amperes), abs=0.2)


def test_only_the_field_of_attraction_and_repulsion_has_a_local_minimum(lesson: Lesson) -> None:
    traps, cup = lesson.names["traps"], lesson.names["space"]
    assert traps["attraction and repulsion"] >= 1 and traps["resistor grid"] == 0
    last = tuple(lesson.names["descent"][-1])
    assert cup.cell[last] == rg.Cell.FREE and not np.isinf(lesson.names["energy"][last])
    around = rg.streamline(lesson.names["grid"], lesson.names["start"])
    assert around.outcome == "reached"
    rg.certify(around)


def test_the_printed_voltages_of_the_path_decrease_to_the_goal(lesson: Lesson) -> None:
    (row,) = re.findall(r"^(0\.9996 [\d.>\s]+) V$", lesson.printed, re.MULTILINE)
    values = [float(part) for part in row.split(">")]
    assert np.all(np.diff(values) < 0) and values[-1] == 0.0
    assert len(values) == len(lesson.names["path"].cells)
    assert "cells visited twice: 0\ncertified\nstep 0: no current runs" in lesson.printed


def test_random_walks_agree_with_the_voltages(lesson: Lesson) -> None:
    volts, fraction, error = (lesson.names[name] for name in ("volts", "fraction", "deviation"))
    assert abs(fraction - volts[6, 2]) < 4 * error
    known, found = lesson.names["known"], lesson.names["found"]
    deviation = np.sqrt(known * (1 - known) / 2000)
    assert np.all(np.abs(found - known) < 5 * deviation + 1e-3)
    exact = rg.planning.collision_probability(
        rg.planning.random_walk(rg.compile_space(rg.build_space(lesson.names["scene"])))
    ).collision
    free = lesson.names["field"].space.cell == rg.Cell.FREE
    np.testing.assert_allclose(volts[free], exact[free], rtol=1e-9)


def answer(number: int) -> str:
    """Return the answer to an exercise, on one line."""
    exercises = TEXT.split("\n## Exercises\n")[1]
    (found,) = re.findall(rf"^{number}\. .*?\{{dropdown\}} Answer\n(.*?):::", exercises, re.MULTILINE | re.DOTALL)
    return " ".join(found.split())


def test_the_answer_on_one_node_is_the_solution_of_its_circuit() -> None:
    volts = np.array([1.0, 1.0, 0.6, 0.2])
    mean = volts.mean()
    assert f"mean is {mean:g} V" in answer(1)
    for amperes in (mean - volts) / 10e3 * 1e6:
        assert f"{abs(amperes):.0f} µA" in answer(1)


def test_doubled_resistors_halve_currents_and_keep_voltages_and_path() -> None:
    assert "Every voltage stays" in answer(2) and "current is halved" in answer(2)
    scene = rg.read_scene("lesson")
    space = rg.build_space(scene)
    ops = [rg.solve(rg.compile_space(space, resistance=ohms)) for ohms in (10e3, 20e3)]
    np.testing.assert_allclose(ops[1].voltage, ops[0].voltage, rtol=1e-12)
    np.testing.assert_allclose(2 * ops[1].source_current, ops[0].source_current, rtol=1e-12)
    first, second = (rg.streamline(rg.field(op), scene.starts[0]) for op in ops)
    np.testing.assert_array_equal(first.cells, second.cells)
    np.testing.assert_allclose(first.points, second.points, rtol=1e-9)


def test_the_corridor_of_three_cells_has_the_voltages_of_the_answer() -> None:
    cells = [[rg.Cell.OBSTACLE], [0], [0], [0], [rg.Cell.GOAL]]
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 5, 5), rg.Axis("y", 0, 1, 1)], cells)
    netlist = rg.compile_space(space, edge="open")
    volts = rg.field(rg.solve(netlist)).potential[1:4, 0]
    np.testing.assert_allclose(volts, [0.75, 0.5, 0.25], rtol=1e-12)
    assert "0.75 V, 0.5 V and 0.25 V" in answer(3)
    assert rg.planning.collision_probability(rg.planning.random_walk(netlist)).success[2, 0] == pytest.approx(0.5)


def test_the_largest_number_of_crossings_is_the_number_of_free_cells() -> None:
    count = int((rg.build_space(rg.read_scene("lesson")).cell == rg.Cell.FREE).sum())
    assert answer(4).count(str(count)) == 3


def test_with_open_obstacles_every_voltage_exceeds_the_mean_of_its_neighbours() -> None:
    space = rg.build_space(rg.read_scene("lesson"))
    netlist = rg.compile_space(space, boundary="neumann", edge="open", resistance=10e3)
    op = rg.solve(netlist)
    (amperes,) = np.unique(netlist.current_amps)
    for (i, j), node in np.ndenumerate(netlist.cells.node):
        if space.cell[i, j] != rg.Cell.FREE:
            continue
        near = [(i + a, j + b) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        near = [c for c in near if min(c) >= 0 and max(c) < 8 and space.cell[c] != rg.Cell.OBSTACLE]
        around = [op.voltage[netlist.cells.node[cell]] for cell in near]
        assert op.voltage[node] == pytest.approx(np.mean(around) + amperes * 10e3 / len(near), rel=1e-9)
        assert min(around) < op.voltage[node]
