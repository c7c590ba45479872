"""Pictures and animations of control, compared with the run; files are complete or absent.

Tests internals: `resgrid.plot.animations`.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from PIL import Image

import resgrid as rg
from resgrid.plot.animations import check_animation, frame_rows


def labels(axes) -> set[str]:
    return {text.get_text() for text in axes.get_legend().get_texts()}


def test_a_run_is_drawn_with_forces_modes_and_learnt_cells(run: rg.control.Run) -> None:
    left, right = rg.draw(run, title="t", caption="c").axes
    assert {"hidden obstacle", "contact force"} <= labels(left)
    named = {rg.control.ControlMode(mode).name.lower() for mode in set(run.mode)} - {"arrived", "dithering"}
    assert named | {"learnt cell", "hidden obstacle", "start"} <= labels(right)
    circles = next(c for c in right.collections if c.get_label() == "learnt cell")
    assert len(circles.get_offsets()) == run.learnt.sum()
    arrows = next(c for c in left.collections if isinstance(c, Quiver))
    drawn, felt = np.stack([arrows.U, arrows.V], axis=1), run.contacts.force
    if len(felt) <= len(drawn):
        ratio = np.hypot(*drawn.T) / np.hypot(*felt.T)
        np.testing.assert_allclose(ratio, ratio[0])
        assert np.all(np.sum(drawn * felt, axis=1) > 0)


def test_runs_at_several_k_are_drawn_in_one_figure(run: rg.control.Run) -> None:
    figure = rg.draw([run, replace(run, field=replace(run.field, k=0.5))])
    assert {"k = 0.98", "k = 0.5"} <= labels(figure.axes[0]) & labels(figure.axes[1])


def test_arrows_of_the_velocity_diagram_satisfy_its_equation(field) -> None:
    axes = rg.plot.draw_velocities(field, (2.0, 0.0), (0.3, 1.0), 0.1)
    arrows = {c.get_label(): np.array([c.U[0], c.V[0]]) for c in axes.collections if isinstance(c, Quiver)}
    nominal = arrows["nominal velocity $V_0$"]
    np.testing.assert_allclose(nominal + arrows["response $AF$"], arrows["$V = V_0 + AF$"])
    along = arrows[r"along the equipotential, $v_\phi$"]
    assert abs(along @ nominal) < 1e-12 * (nominal @ nominal)
    assert along @ [0.3, 1.0] >= 0
    assert {"equipotential of the robot", "streamline"} <= labels(axes)


def test_the_dirichlet_fraction_lies_between_0_and_1(space, field, neumann) -> None:
    planner = rg.plan(space, k=0.98)
    share = planner.dirichlet_fraction()
    assert np.nanmin(share) >= 0 and np.nanmax(share) <= 1
    assert np.all(planner.at(1.0).dirichlet_fraction()[space.goal_connected] == 1)
    with pytest.raises(rg.InputError, match="0 <= k <= 1"):
        planner.at(2.0).dirichlet_fraction()
    axes = rg.plot.draw_dirichlet_fraction(field, neumann, 0.98)
    assert axes.images


@pytest.fixture(scope="module")
def front(scene: rg.Scene) -> rg.control.Wavefront:
    return rg.control.wavefront(rg.simulation(scene, announce=True, pace=2.0), np.array([0.0, 1, 5]))


def test_a_wavefront_is_drawn_as_panels_and_as_an_animation(
    front: rg.control.Wavefront, run: rg.control.Run, tmp_path
) -> None:
    figure = rg.draw(front)
    assert len([axes for axes in figure.axes if axes.get_title()]) == 3
    with pytest.raises(rg.InputError, match="0 to 2"):
        rg.draw(front, shown=[3])
    file = rg.animate(front, tmp_path / "front.gif", run=run, rate=5)
    with Image.open(file) as picture:
        assert picture.n_frames == 3
        assert picture.info["duration"] == 200


def frames_of(file) -> list[np.ndarray]:
    with Image.open(file) as picture:
        return [np.asarray((picture.seek(number), picture.convert("RGB"))[1]) for number in range(picture.n_frames)]


def test_a_long_run_with_many_lessons_is_shown_to_its_end(run: rg.control.Run) -> None:
    rows = np.arange(4000)
    lessons = tuple(replace(run.lessons[0], step=int(step)) for step in rows[:1500:3])
    long = replace(run, time=rows.astype(np.float64), lessons=lessons)
    shown = frame_rows(long, 500)
    assert len(shown) == 588
    assert {0, 3999} <= set(shown.tolist()) and np.diff(shown).max() <= 9
    assert set(range(0, 90, 3)) <= set(shown.tolist())  # the earliest lessons


@pytest.mark.slow
def test_an_animation_of_a_run_contains_its_first_and_last_frame(run: rg.control.Run, tmp_path) -> None:
    assert {0, len(run.time) - 1} <= set(frame_rows(run, 6).tolist())
    drawn: list[int] = []
    first, *_, last = frames_of(rg.animate(run, tmp_path / "run.gif", count=3, progress=drawn.append))
    assert drawn == list(range(1, len(drawn) + 1))
    middle = first.shape[1] // 2
    for frame in (first, last):
        for panel in (frame[:, :middle], frame[:, middle:]):
            assert (panel == [232, 73, 29]).all(axis=2).any()  # the goal
    changed = (first != last).any(axis=2)
    assert changed[:, :middle].any() and changed[:, middle:].any()
    near_blue = np.abs(first[:, :middle].astype(int) - [0, 114, 178]).sum(axis=2) < 120
    assert near_blue.sum() > 40  # the robot, in addition to its mark in the legend
    np.testing.assert_array_equal(first[[0, -1]], 255)  # no content touches the border
    np.testing.assert_array_equal(first[:, [0, -1]], 255)
    with pytest.raises(rg.InputError, match="frames"):
        rg.animate(run, tmp_path / "b.gif", count=1)


def test_a_patch_has_the_same_colour_in_every_frame(front: rg.control.Wavefront, monkeypatch, tmp_path) -> None:
    """The colour is exact although gradients of 300 other colours change around the patch."""
    ramp = np.linspace(0, 255, 90).astype(np.uint8)
    images = []
    for number in range(5):
        image = np.zeros((60, 90, 3), np.uint8)
        image[..., number % 3], image[..., (number + 1) % 3] = ramp, ramp[:60, None] // (number + 1)
        image[4:9, 4:9] = (230, 159, 0)
        images.append(image)

    def frames(_front, _run):
        figure = FigureCanvasAgg(Figure(figsize=(0.9, 0.6), dpi=100)).figure
        for image in images:
            figure.clear()
            figure.figimage(image)
            yield figure

    monkeypatch.setattr("resgrid.plot.animations._wavefront_frames", frames)
    for drawn, expected in zip(frames_of(rg.animate(front, tmp_path / "a.gif")), images, strict=True):
        np.testing.assert_array_equal(drawn[4:9, 4:9], expected[4:9, 4:9])
        assert np.abs(drawn.astype(int) - expected).max() <= 24


def test_an_interrupted_or_invalid_animation_leaves_no_file(front: rg.control.Wavefront, tmp_path, monkeypatch) -> None:
    def interrupt(_number: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rg.animate(front, tmp_path / "a.gif", progress=interrupt)
    with pytest.raises(rg.InputError, match=r"\.gif or \.mp4"):
        rg.animate(front, tmp_path / "a.png")
    with pytest.raises(rg.InputError, match="rate"):
        rg.animate(front, tmp_path / "a.gif", rate=0)
    assert not list(tmp_path.iterdir())
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(rg.ToolMissingError, match="ffmpeg"):
        check_animation("a.mp4")


FAKE = """#!{python}
import sys
if "{mode}" == "fail":
    sys.stdin.buffer.read(1); sys.stderr.write("no such codec"); sys.exit(3)
open(sys.argv[-1], "wb").write(sys.argv[sys.argv.index("-s") + 1].encode() + b" " + sys.stdin.buffer.read())
"""


@pytest.mark.slow
def test_mp4_frames_are_piped_to_ffmpeg_and_its_errors_are_reported(
    front: rg.control.Wavefront, tmp_path, monkeypatch
) -> None:
    """Substitutes for ffmpeg: one writes its input to the file, one fails."""
    tool = tmp_path / "bin" / "ffmpeg"
    tool.parent.mkdir()
    monkeypatch.setenv("PATH", str(tool.parent))
    for mode in ("keep", "fail"):
        tool.write_text(FAKE.format(python=sys.executable, mode=mode))
        tool.chmod(0o755)
        if mode == "keep":
            size, _, pixels = rg.animate(front, tmp_path / "a.mp4").read_bytes().partition(b" ")
            width, height = map(int, size.split(b"x"))
            assert len(pixels) == 3 * 4 * width * height  # three frames
            assert width % 2 == height % 2 == 0
        else:
            with pytest.raises(rg.InputError, match="no such codec"):
                rg.animate(front, tmp_path / "b.mp4")
            assert not (tmp_path / "b.mp4").exists()
