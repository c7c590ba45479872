"""Validation of the arguments of all public functions and classes; messages contain the argument's name.

Tests internals: `resgrid._internal.validation`.
"""

from __future__ import annotations

import pickle
import types
from contextlib import suppress
from inspect import Parameter, isabstract, ismodule, signature, unwrap
from pathlib import Path
from typing import Annotated, Any, is_typeddict

import numpy as np
import pytest
from annotated_types import Gt
from matplotlib.figure import Figure

import resgrid as rg
from resgrid._internal.validation import TypeCheck, type_check_of, type_checks_of

PACKAGES = [rg, *(getattr(rg, name) for name in rg.__all__ if ismodule(getattr(rg, name)))]
PUBLIC = {f"{package.__name__}.{name}": getattr(package, name) for package in PACKAGES for name in package.__all__}
FUNCTIONS = [name for name, value in PUBLIC.items() if isinstance(value, types.FunctionType)]
WRONG: dict[str, Any] = {
    "None": None,
    "text": "chair.toml",
    "path": Path("chair.toml"),
    "list": [object()],
    "scene": object.__new__(rg.Scene),
    "planner": object.__new__(rg.planning.Planner),
    "nan": float("nan"),
    "true": True,
    "class": rg.Scene,
    "object": object(),
}


CLASSES = [
    value for value in PUBLIC.values() if isinstance(value, type) and not isabstract(value) and not is_typeddict(value)
]
PLAIN = (1.0, 1, "auto", None, (1.0, 1.0), [], {}, print, [1], [("a", [])], ("a", []), True)


def accepted_value(kind: TypeCheck) -> Any:
    """Return a value that the type check accepts; an uninitialized instance for a class."""
    shells = (object.__new__(one) for one in CLASSES if not issubclass(one, BaseException | str | int))
    return next(value for value in (*PLAIN, rg.PointRobot(), rg.Frame(), Figure(), *shells) if kind.accepts(value))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_of_wrong_type_raise_input_error_with_their_name(name: str) -> None:
    """All public functions are covered, including new ones; types are checked before any computation."""
    function = PUBLIC[name]
    kinds = type_checks_of(function.__wrapped__)
    given: dict[str, Any] = {}
    for parameter in signature(function).parameters.values():
        if parameter.kind in (Parameter.VAR_KEYWORD, Parameter.VAR_POSITIONAL):
            continue
        assert parameter.name in kinds, f"{name}({parameter.name}) needs a type"
        kind = kinds[parameter.name]
        for label, wrong in WRONG.items():
            if kind.accepts(wrong):
                continue
            with pytest.raises(rg.InputError) as caught:
                function(**given, **{parameter.name: wrong})
            assert str(caught.value).startswith((f"{parameter.name} = ", f"{parameter.name}[0] = ")), label
            assert " must be " in str(caught.value), label
        if parameter.default is Parameter.empty:
            given[parameter.name] = accepted_value(kind)


def test_messages_for_common_mistakes_contain_the_correct_call() -> None:
    scene = object.__new__(rg.Scene)
    planner = object.__new__(rg.planning.Planner)
    for call, words in (
        (lambda: rg.simulation("chair.toml"), ("scene = 'chair.toml'", "rg.read_scene(file)")),
        (lambda: rg.solve(scene), ("netlist = <a Scene>", "rg.compile_space(space)")),
        (lambda: rg.streamline(planner, (0, 0)), ("field = <a Planner>", "rg.plan(scene).field")),
        (lambda: rg.control.make_controller(planner), ("field = <a Planner>", "rg.plan(scene).field")),
    ):
        with pytest.raises(rg.InputError) as caught:
            call()
        assert all(word in str(caught.value) for word in words), caught.value


def test_type_checks_accept_numpy_numbers_and_reject_other_types() -> None:
    for hint, right, wrong in (
        (float, (0.4, 1, np.float32(0.4), np.int64(1), np.inf), (True, np.nan, "1", 1j, [1.0], None)),
        (int, (1, np.int8(1)), (True, 1.0, "1", np.float64(1), None)),
        (bool, (True, np.bool_(0)), (0, 1, None, "true")),
    ):
        assert all(map(type_check_of(hint).accepts, right)), hint
        assert not any(map(type_check_of(hint).accepts, wrong)), hint


def test_public_functions_keep_name_docstring_and_pickling() -> None:
    for name in FUNCTIONS:
        function = PUBLIC[name]
        assert pickle.loads(pickle.dumps(function)) is function
        assert f"{function.__module__}.{function.__name__}" == name
        assert function.__qualname__ == function.__name__
        assert function.__doc__ == function.__wrapped__.__doc__


def test_an_unknown_attribute_raises_attribute_error_with_the_closest_name() -> None:
    with pytest.raises(AttributeError, match="did you mean 'streamline'"):
        rg.streamlin  # noqa: B018


def test_numbers_beyond_doubles_and_other_invalid_values_raise_input_error(tmp_path: Path) -> None:
    space = rg.build_space(rg.read_scene(Path(__file__).parents[2] / "examples/scenes/lesson.toml"))
    netlist = rg.compile_space(space)
    for call in (
        lambda: rg.compile_space(space, resistance=10**400),
        lambda: rg.compile_space(space, resistance=1e-320),
        lambda: rg.compile_space(space, start=np.array(3.0)),
        lambda: rg.chip.build_chip(netlist, [[]]),
        lambda: rg.chip.effects.to_json({"a": 1}),
        lambda: rg.write_spice(netlist, ""),
        lambda: rg.control.random_forces(-1, 2, until=1.0, size=1.0, duration=0.1),
        lambda: rg.control.random_forces(0, 0, until=1.0, size=1.0, duration=0.1),
        lambda: rg.control.random_forces(0, 2, until=np.inf, size=1.0, duration=0.1),
        lambda: rg.draw(rg.find_blocking_obstacles(space, (0.5, 6.5)), virtual=np.zeros((8, 8))),
        lambda: rg.plot.draw_velocities(rg.plan(space).field, (0.7, 6.0), force=(np.inf, 0.0), admittance=np.eye(2)),
        lambda: rg.field(None),
        lambda: rg.Polyline([(0.5, 6.5)], None),
        lambda: rg.Polyline(10**400, space),
        lambda: rg.circuit.WarmStart(space),
        lambda: rg.spice.analyses.Measure("rise", "a", "crossing", at=np.inf),
        lambda: rg.Box(np.array([np.inf, 0.0]), np.array([1.0, 1.0])),
    ):
        with pytest.raises(rg.InputError):
            call()
    one = rg.study(netlist).noise_density([1], np.float32(0.5))
    np.testing.assert_array_equal(one, rg.study(netlist).noise_density([1], 0.5))


RECORDS: dict[Any, dict[str, Any]] = {
    rg.Axis: {"name": "x", "lower": 0.0, "upper": 1.0, "cells": 2},
    rg.Frame: {},
    rg.PointRobot: {},
    rg.DiscRobot: {"radius": 0.1},
    rg.PolygonRobot: {"vertices": ((0, 0), (1, 0), (0, 1))},
    rg.Arm: {"lengths": (1.0, 1.0), "widths": (0.0, 0.0), "limits": (None, None)},
    rg.Box: {"lower": (0.0, 0.0), "upper": (1.0, 1.0)},
    rg.Ball: {"centre": (0.0, 0.0), "radius": 1.0},
    rg.Polygon: {"vertices": ((0, 0), (1, 0), (0, 1))},
    rg.HalfSpace: {"normal": (1.0, 0.0), "offset": 0.0},
    rg.GoalPoint: {"point": (1.0, 1.0)},
    rg.GoalCell: {"cell": (1, 1)},
    rg.GoalJoints: {"lower": (0.0, 0.0), "upper": (1.0, 1.0)},
    rg.control.ExternalForce: {"start": 0.0, "duration": 1.0, "force": (1.0, 1.0)},
    rg.spice.analyses.TransientAnalysis: {"stop": 1.0, "step": 0.1},
    rg.spice.analyses.NoiseAnalysis: {"node": "a"},
    rg.spice.analyses.TemperatureAnalysis: {"celsius": (27.0,)},
    rg.spice.analyses.MismatchAnalysis: {"sigma": 0.1},
    rg.spice.analyses.Probe: {"nodes": ("a",)},
    rg.spice.analyses.Measure: {"name": "rise", "node": "a", "what": "crossing", "at": 0.5},
}


@pytest.mark.parametrize("value_class", RECORDS, ids=lambda value_class: value_class.__name__)
def test_value_classes_reject_arguments_of_wrong_type(value_class: Any) -> None:
    right = RECORDS[value_class]
    value_class(**right)
    for name in signature(value_class).parameters:
        accepts = type_checks_of(unwrap(value_class.__init__))[name].accepts
        for wrong in (*WRONG.values(), 10**400, ["a", 1], []):
            if not accepts(wrong):
                with pytest.raises(rg.InputError, match=name):
                    value_class(**{**right, name: wrong})
            elif wrong is not None:
                with suppress(rg.InputError):  # the type is valid, the value may be invalid
                    value_class(**{**right, name: wrong})
    single = {key: np.float32(value) if isinstance(value, float) else value for key, value in right.items()}
    value_class(**single)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rg.Frame(x=np.inf), "x = inf"),
        (lambda: rg.Frame(yaw=-np.inf), "yaw = -inf"),
        (lambda: rg.GoalPoint((0.0, np.inf)), r"point\[1\] = inf"),
        (lambda: rg.Ball((0.0, 1e61), 1.0), r"centre\[1\] = 1e\+61"),
        (lambda: rg.Ball((0.0, 0.0), -1.0), "radius = -1.0 must be a finite number at least 0"),
        (lambda: rg.DiscRobot(0.0), "radius = 0.0 must be a finite number above 0"),
        (lambda: rg.CostArea(rg.Box((0.0,), (1.0,)), -1.0), "conductivity = -1.0 must be a finite number above 0"),
        (
            lambda: rg.Arm((1.0, 1.0), singularity_width=4.0),
            "singularity_width = 4.0 must be .* below 3.14159, or None",
        ),
        (lambda: rg.Wiring("dirichlett"), "boundary = 'dirichlett' must be 'dirichlet' or 'neumann' or 'wall'"),
        (lambda: rg.GoalCell((10**5000,)), r"cell\[0\] = a number with too many digits"),
    ],
)
def test_limits_in_annotations_are_enforced(make: Any, words: str) -> None:
    with pytest.raises(rg.InputError, match=words):
        make()
    assert type_check_of(Annotated[float, Gt(0)]).accepts(np.float32(1.0))
