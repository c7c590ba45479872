"""The [control] table of scenes: defaults of `rg.simulation`, and messages for invalid values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import resgrid as rg

SCENE = """
schema = 1
starts = [[0.5, 0.5]]
[grid]
axes = [{ name = "x", lower = 0, upper = 6, cells = 12 }, { name = "y", lower = 0, upper = 5, cells = 10 }]
[[obstacle]]
shape = "rectangle"
lower = [2, 0]
upper = [3, 3]
[[hidden]]
shape = "circle"
centre = [2.5, 4.2]
radius = 0.3
[[goal]]
point = [5.25, 0.75]
"""
TABLE = """
[control]
speed = 0.5
speed_limits = 0.4
admittance = [0.2, 0.0, 0.0, 0.3]
friction = 0.1
step = 0.1
k = 0.9
bias = [0.01, -0.01]
seed = 3
"""


def test_arguments_override_the_control_table_and_its_defaults() -> None:
    scene = rg.parse_scene(SCENE + TABLE)
    world = rg.simulation(scene)
    controller = world.controller
    assert (controller.speed, world.friction, world.step, controller.field.k) == (0.5, 0.1, 0.1, 0.9)
    assert controller.speed_limits.tolist() == [0.4, 0.4]
    assert controller.admittance.tolist() == [[0.2, 0.0], [0.0, 0.3]]
    assert rg.simulation(scene, speed=0.25, k=0.5).controller.speed == 0.25
    run = world.run()
    assert run.ending is rg.control.TerminationReason.ARRIVED
    assert np.abs(np.diff(run.configuration, axis=0) / np.diff(run.time)[:, None]).max() <= 0.4 + 1e-9
    usual = rg.simulation(rg.parse_scene(SCENE))
    assert (usual.friction, usual.learn, usual.controller.response) == (0.2, True, "equipotential")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speed = 0", "line 17: control.speed: must be greater than 0, got 0"),
        ("sped = 1", "line 17: control.sped: unknown key; did you mean 'speed'?"),
        ('response = "softly"', "control.response: 'softly' is unknown: it may be equipotential or admittance"),
        ("learn = 1", "control.learn: must be true or false, got 1"),
        ("step = 0.6", "control.step: must be at most 0.5, got 0.6"),
        ('push = [[0.0, "x", 1]]', "control.push[0][1]: must be a number, got 'x'"),
        ("bias = []", "control.bias: needs at least 1 entries, got 0"),
        ("k = nan", "control.k: must be a finite number, got nan"),
        ("bias = [1, 2, 3]", "line 17: control.bias: needs 1 number for all axes, or one for each of the 2 axes, got"),
        ("noise = [0.1, -0.1]", "line 17: control.noise[1]: must be at least 0, got -0.1"),
        ("speed_limits = [1, 0]", "line 17: control.speed_limits[1]: must be greater than 0, got 0"),
        ("speed_limits = [1, 1, 1]", "line 17: control.speed_limits: needs 1 number for all"),
        ("admittance = [1, 2, 3]", "line 17: control.admittance: the admittance has 3 numbers; give 1 number, 2 for a"),
        ("admittance = [1, 2, 2, 1]", "line 17: control.admittance: the admittance is not positive definite"),
        ("push = [[0, 1]]", "line 17: control.push[0]: needs at least 3 entries, got 2"),
        ("push = [[0, 1, 1, 1], [0, 1, 1]]", "line 17: control.push[1]: needs a time, a duration and a force of 2"),
        ("push = [[-1, 1, 1, 1]]", "line 17: control.push[0][0]: a push begins at a time of at least 0 s, got -1"),
        ("push = [[0, 0, 1, 1]]", "line 17: control.push[0][1]: a push lasts longer than 0 s, got 0"),
    ],
)
def test_invalid_control_values_are_reported_with_line_and_key(text: str, message: str) -> None:
    with pytest.raises(rg.InputError) as caught:
        rg.parse_scene(f"{SCENE}[control]\n{text}\n")
    assert message in str(caught.value)


def test_errors_of_a_file_are_reported_with_its_name_and_lines(tmp_path: Path) -> None:
    file = tmp_path / "shaken.toml"
    file.write_text(f"{SCENE}[control]\nbias = [1, 2, 3]\npush = [[0, 0, 1, 1]]\n")
    with pytest.raises(rg.InputError, match=r"shaken.toml: 2 errors\n  line 17: control.bias.*\n  line 18: control"):
        rg.read_scene(file)


def test_control_tables_made_in_python_are_checked() -> None:
    assert rg.control.Control(admittance=0.5).admittance == (0.5,)
    with pytest.raises(rg.InputError, match="friction: must be at least 0"):
        rg.control.Control(friction=-0.1)
    with pytest.raises(rg.InputError, match=r"noise\[1\]: must be at least 0"):
        rg.control.Control(noise=(0.1, -0.02))
