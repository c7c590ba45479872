"""Round trips of random scenes through documents and of points through frames.

Tests internals: `resgrid.scene.overrides`, `resgrid.scene.reading`.
"""

import numpy as np
from hypothesis import given, settings, strategies as st

import resgrid as rg
from resgrid.scene.overrides import document_of
from resgrid.scene.reading import build_scene

number = st.floats(-1e6, 1e6, allow_nan=False)
positive = st.floats(1e-9, 1e9)


@st.composite
def scenes(draw):
    ndim = draw(st.integers(1, 4))
    point = st.tuples(*[number] * ndim)
    axes = tuple(
        rg.Axis(name, float(low), low + 3.5, draw(st.integers(1, 50)), draw(st.booleans()), "m")
        for name, low in zip("xyzw", draw(st.lists(st.integers(-5, 5), min_size=ndim, max_size=ndim)), strict=False)
    )
    box = st.builds(lambda a, b: rg.Box(tuple(map(min, a, b)), tuple(map(max, a, b))), point, point)
    ball = st.builds(rg.Ball, point, st.floats(0, 1e3))
    upright = [0.0 if axis.periodic else 1.0 for axis in axes]
    half = st.builds(rg.HalfSpace, st.just(tuple(upright)), number) if any(upright) else box
    shape = st.one_of(box, ball, half)
    goal = st.one_of(
        shape, st.builds(rg.GoalPoint, point), st.builds(rg.GoalCell, st.tuples(*[st.integers(0, 9)] * ndim))
    )
    return rg.Scene(
        axes=axes,
        title=draw(st.text(max_size=10)),
        robot=rg.PointRobot(draw(st.floats(0, 10))),
        obstacles=tuple(draw(st.lists(shape, max_size=3))),
        hidden=tuple(draw(st.lists(shape, max_size=2))),
        goals=tuple(draw(st.lists(goal, max_size=3))),
        starts=tuple(draw(st.lists(point, max_size=3))),
        areas=tuple(draw(st.lists(st.builds(rg.CostArea, shape, positive), max_size=2))),
        boundary=draw(st.sampled_from(["dirichlet", "neumann"])),
        edge=tuple("periodic" if axis.periodic else draw(st.sampled_from(["obstacle", "open"])) for axis in axes),
        k=tuple(draw(st.lists(st.floats(0, 1), max_size=3))),
        chip=rg.Chip(resistance=draw(positive), capacitance=draw(st.none() | positive)),
        sampling=draw(st.sampled_from(["conservative", "centre"])),
        source="s",
    )


@settings(max_examples=100)
@given(scenes())
def test_scenes_round_trip_through_documents(scene):
    again = build_scene(document_of(scene), "s", None)
    for name in scene.__dataclass_fields__:
        assert getattr(again, name) == getattr(scene, name), name


@given(number, number, st.floats(-10, 10), st.lists(st.tuples(number, number), min_size=1))
def test_points_round_trip_through_frames(x, y, yaw, points):
    frame = rg.Frame(x, y, yaw)
    assert np.allclose(frame.to_world(frame.from_world(points)), points, rtol=0, atol=1e-8)
    assert np.allclose(frame.from_world(frame.to_world(points)), points, rtol=0, atol=1e-8)


def test_a_frame_turns_anticlockwise_about_its_origin():
    frame = rg.Frame(2.0, 3.0, np.pi / 2)
    assert np.allclose(frame.to_world([[0, 0], [1, 0], [0, 1]]), [[2, 3], [2, 4], [1, 3]])
    assert np.allclose(frame.from_world([1, 3]), [0, 1])
