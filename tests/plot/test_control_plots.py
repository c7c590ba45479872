"""Pictures and animations of control: what is on them, and that files are whole or not there."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from matplotlib.quiver import Quiver
from PIL import Image

import resgrid as rg
from resgrid.control.log import Mode, Run
from resgrid.control.relaxation import Relaxation, Wavefront, wavefront
from resgrid.control.relaxation_ratio import RelaxationSweep
from resgrid.errors import InputError, ToolMissingError
from resgrid.plot.animations import frame_rows, run_frames, wavefront_frames
from resgrid.plot.films import check_animation, save_animation

TEXT = """
schema = 1
title = "Room"
starts = [[4.2, 7.2]]
k = [0.98]
[robot]
type = "disc"
radius = 0.2
[grid]
axes = [{ name = "x", lower = 0, upper = 8, cells = 16 }, { name = "y", lower = 0, upper = 8, cells = 16 }]
[[goal]]
point = [4.2, 0.7]
[[hidden]]
shape = "rectangle"
lower = [2.5, 3.0]
upper = [6.2, 4.0]
"""


@pytest.fixture(scope="module")
def scene() -> rg.Scene:
    return rg.parse_scene(TEXT.replace('type = "disc"', 'type = "point"'), "room")


@pytest.fixture(scope="module")
def run(scene: rg.Scene) -> Run:
    return rg.simulation(scene).run(scene.starts[0])


def labels(axes) -> set[str]:
    return {text.get_text() for text in axes.get_legend().get_texts()}


def test_a_run_shows_forces_modes_and_lessons(run: Run, scene: rg.Scene) -> None:
    left, right = rg.plot_run(run, scene, title="t", caption="c").axes
    assert {"hidden obstacle", "contact force"} <= labels(left)
    named = {Mode(mode).name.lower() for mode in set(run.mode)} - {"arrived", "dithering"}
    assert named | {"cell learnt", "hidden obstacle", "start"} <= labels(right)
    circles = next(c for c in right.collections if c.get_label() == "cell learnt")
    assert len(circles.get_offsets()) == run.learnt.sum()
    arrows = next(c for c in left.collections if isinstance(c, Quiver))
    drawn, felt = np.stack([arrows.U, arrows.V], axis=1), run.contacts.force
    if len(felt) <= len(drawn):
        ratio = np.hypot(*drawn.T) / np.hypot(*felt.T)
        np.testing.assert_allclose(ratio, ratio[0])
        assert np.all(np.sum(drawn * felt, axis=1) > 0)


def test_runs_at_several_k_share_a_picture(run: Run, scene: rg.Scene) -> None:
    figure = rg.plot_runs_by_k([run, run], (0.98, 0.5), scene)
    assert {"k = 0.98", "k = 0.5"} <= labels(figure.axes[0]) & labels(figure.axes[1])


def test_the_velocity_diagram_adds_up(field) -> None:
    axes = rg.plot_velocities(field, (2.0, 0.0), (0.3, 1.0), 0.1)
    arrows = {c.get_label(): np.array([c.U[0], c.V[0]]) for c in axes.collections if isinstance(c, Quiver)}
    nominal = arrows["nominal velocity $V_0$"]
    np.testing.assert_allclose(nominal + arrows["answer $AF$"], arrows["$V = V_0 + AF$"])
    along = arrows[r"along the equipotential, $v_\phi$"]
    assert abs(along @ nominal) < 1e-12 * (nominal @ nominal)
    assert along @ [0.3, 1.0] >= 0
    assert {"the robot's equipotential", "streamline"} <= labels(axes)


def test_the_share_of_dirichlet_lies_between_none_and_all(space, field, neumann) -> None:
    share = rg.dirichlet_share(field, neumann, 0.98)
    assert np.nanmin(share) >= 0 and np.nanmax(share) <= 1
    assert np.all(rg.dirichlet_share(field, neumann, 1.0)[space.goal_connected] == 1)
    with pytest.raises(InputError, match="0 <= k <= 1"):
        rg.dirichlet_share(field, neumann, 2.0)
    axes = rg.plot_dirichlet_share(field, neumann, 0.98)
    assert axes.images


def test_a_sweep_marks_what_did_not_arrive() -> None:
    ratio = np.array([100.0, 10.0])
    sweep = RelaxationSweep(
        Relaxation("sor"), 50.0, 50 / ratio, ratio, (rg.Ending.STALLED, rg.Ending.ARRIVED), np.array([80.0, 20.0]),
        np.array([40.0, 0.0]), 19.0,
    )  # fmt: skip
    assert (sweep.safe_ratio, sweep.failing_ratio) == (10.0, 100.0)
    axes = rg.plot_settling_sweep([sweep])
    assert {"did not arrive", "SOR sweeps: settles in 50"} <= labels(axes)
    with pytest.raises(InputError, match="no sweep"):
        rg.plot_settling_sweep([])


@pytest.fixture(scope="module")
def front(scene: rg.Scene) -> Wavefront:
    sim = rg.simulation(scene)
    return wavefront(
        rg.make_relaxation(scene, pace=2.0), sim.space, sim.plant.true_space(sim.space), np.array([0.0, 1, 5])
    )


def test_a_wavefront_is_a_row_of_pictures_and_an_animation(front: Wavefront, run: Run, tmp_path) -> None:
    figure = rg.plot_wavefront(front)
    assert len([axes for axes in figure.axes if axes.get_title()]) == 3
    file = rg.save_animation(wavefront_frames(front, run), tmp_path / "front.gif", rate=5)
    with Image.open(file) as picture:
        assert picture.n_frames == 3
        assert picture.info["duration"] == 200


def test_an_animation_of_a_run_holds_its_lessons_and_its_end(run: Run, scene: rg.Scene, tmp_path) -> None:
    rows = frame_rows(run, 6)
    assert {0, len(run.time) - 1} <= set(rows.tolist())
    told: list[int] = []
    file = rg.save_animation(rg.run_frames(run, scene, count=3), tmp_path / "run.gif", progress=told.append)
    with Image.open(file) as picture:
        assert picture.n_frames > 3
    assert told == list(range(1, len(told) + 1))
    with pytest.raises(InputError, match="frames"):
        next(run_frames(run, scene, count=1))


def test_a_colour_is_the_same_in_every_frame(tmp_path) -> None:
    """A patch keeps its colour to the bit, whatever gradients come and go around it in 300 other colours."""
    ramp = np.linspace(0, 255, 90).astype(np.uint8)

    def frames():
        for number in range(5):
            frame = np.zeros((60, 90, 3), np.uint8)
            frame[..., number % 3], frame[..., (number + 1) % 3] = ramp, ramp[:60, None] // (number + 1)
            frame[4:9, 4:9] = (230, 159, 0)
            yield frame

    with Image.open(save_animation(frames(), tmp_path / "a.gif")) as picture:
        for number, expected in enumerate(frames()):
            picture.seek(number)
            drawn = np.asarray(picture.convert("RGB")).astype(int)
            np.testing.assert_array_equal(drawn[4:9, 4:9], expected[4:9, 4:9])
            assert np.abs(drawn - expected).max() <= 24


@pytest.mark.parametrize("robot", ['type = "point"', 'type = "point"\nradius = 0.2'])
def test_frames_of_a_point_show_where_it_is_where_it_began_and_where_it_goes(robot: str) -> None:
    scene = rg.parse_scene(TEXT.replace('type = "disc"\nradius = 0.2', robot), "room")
    run = rg.simulation(scene).run(scene.starts[0])
    first, *_, last = rg.run_frames(run, scene, count=3)
    middle = first.shape[1] // 2
    blue, orange = np.array([0, 114, 178]), np.array([230, 159, 0])
    for frame in (first, last):
        for panel in (frame[:, :middle], frame[:, middle:]):
            assert (panel == orange).all(axis=2).any()  # the goal
    changed = (first != last).any(axis=2)
    assert changed[:, :middle].any() and changed[:, middle:].any()
    near_blue = np.abs(first[:, :middle].astype(int) - blue).sum(axis=2) < 120
    assert near_blue.sum() > 40  # the robot, besides its mark in the legend
    np.testing.assert_array_equal(first[[0, -1]], 255)  # nothing is cut at the border
    np.testing.assert_array_equal(first[:, [0, -1]], 255)


def test_an_animation_that_is_interrupted_leaves_nothing(tmp_path, monkeypatch) -> None:
    def frames():
        yield np.zeros((4, 4, 3), np.uint8)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_animation(frames(), tmp_path / "a.gif")
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"\.gif or \.mp4"):
        save_animation([], tmp_path / "a.png")
    with pytest.raises(InputError, match="at least one frame"):
        save_animation([], tmp_path / "a.gif")
    with pytest.raises(InputError, match="rate"):
        save_animation([], tmp_path / "a.gif", rate=0)
    assert not list(tmp_path.iterdir())
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ToolMissingError, match="ffmpeg"):
        check_animation("a.mp4")


FAKE = """#!{python}
import sys
words = sys.argv
if "{mode}" == "fail":
    sys.stdin.buffer.read(1); sys.stderr.write("no such codec"); sys.exit(3)
open(words[-1], "wb").write(words[words.index("-s") + 1].encode() + b" " + sys.stdin.buffer.read())
"""


def test_mp4_goes_through_ffmpeg(tmp_path, monkeypatch) -> None:
    """A stand-in for ffmpeg that keeps what it is fed; and one that fails."""
    tool = tmp_path / "bin" / "ffmpeg"
    tool.parent.mkdir()
    monkeypatch.setenv("PATH", str(tool.parent))
    frames = [np.full((4, 6, 3), value, np.uint8) for value in (65, 66)]
    for mode in ("keep", "fail"):
        tool.write_text(FAKE.format(python=sys.executable, mode=mode))
        tool.chmod(0o755)
        if mode == "keep":
            save_animation(iter(frames), tmp_path / "a.mp4")
            assert (tmp_path / "a.mp4").read_bytes() == b"6x4 " + b"A" * 72 + b"B" * 72
        else:
            with pytest.raises(InputError, match="no such codec"):
                save_animation(iter(frames), tmp_path / "b.mp4")
            assert not (tmp_path / "b.mp4").exists()
