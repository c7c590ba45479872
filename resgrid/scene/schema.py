"""The schema of scene files as pydantic models, and the validation of documents, which reports all errors at once.

Other modules import this one inside functions only, because pydantic models take long to build.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from annotated_types import Ge, Gt, Le, Len
from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    PlainValidator,
    Strict,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    create_model,
    field_validator,
    model_validator,
)

from resgrid._internal.validation import short
from resgrid.core.axis import Axis
from resgrid.core.wiring import EdgeRule
from resgrid.errors import suggestion
from resgrid.robots import ROBOTS, Arm, PointRobot, Robot
from resgrid.robots.arm import Length, Width
from resgrid.scene.chip import Chip, Defects, Readout
from resgrid.scene.control import Control
from resgrid.scene.goals import Conductivity, CostArea, GoalCell, GoalPoint, GoalPose
from resgrid.scene.joint_goals import JOINT_GOALS, Coordinates
from resgrid.scene.maps.arrays import HEADINGS
from resgrid.scene.maps.formats import FORMATS, map_options
from resgrid.scene.mask import Mask
from resgrid.scene.messages import Problem, message_of, problems_of, unknown_option
from resgrid.scene.quantities import Listed
from resgrid.scene.scene import IN_FILES, LISTS, Scene
from resgrid.scene.shape_tables import READERS, REGIONS, SHAPES, file_annotations, shape_annotations
from resgrid.scene.table_models import TableModel, fields_from, filled_as, meanings, table_of, value_of
from resgrid.scene.toml_lines import Path

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

Pair = Annotated[tuple[float, ...], Strict(False), Len(2, 2)]
Count = Annotated[int, Ge(1), Le(10**15)]


class Link(TableModel):
    """A link of an arm: its length and width in axis units, and the range of its joint angle in radians."""

    length: Annotated[Length, Field(description="Distance between its two joints.")]
    width: Annotated[Width, Field(description="Width of the capsule that the link occupies.")] = 0.0
    limits: Annotated[
        Pair | None, Field(description="Range of its joint angle, in radians; without limits the joint is periodic.")
    ] = None

    @model_validator(mode="after")
    def _is_possible(self) -> Link:
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            low, high = self.limits
            fault = "are reversed: the lower limit comes first" if low > high else "are equal: the joint cannot turn"
            raise ValueError(f"limits = {[low, high]} {fault}; leave limits out for a joint without stops")
        return self


def _arm(links: list[Link], **rest: Any) -> Arm:
    lengths, widths, limits = zip(*((link.length, link.width, link.limits) for link in links), strict=True)
    return Arm(lengths=lengths, widths=widths, limits=limits, **rest)


def _arm_table() -> Any:
    """Return the pydantic model of an arm's table, with a list of links in place of lists of their properties."""
    whole = table_of(Arm, ("type", "arm"))
    keys: dict[str, Any] = {name: (field.rebuild_annotation(), field) for name, field in whole.model_fields.items()}
    for name in ("lengths", "widths", "limits"):
        del keys[name]
    keys["links"] = (Annotated[list[Link], Len(1, 4)], Field(description="Links, from the base to the tip."))
    return create_model("type_arm", __base__=TableModel, __doc__=whole.__doc__, **keys)


def _area(shape: type, name: str, is_planar: bool) -> Any:
    """Return the pydantic annotation of a cost area: the table of a shape with the additional key ``conductivity``.

    `shape`: class of the shape; `name`: its name in files; `is_planar`: whether points must have two coordinates.
    """
    keys: dict[str, Any] = {"conductivity": (Conductivity, Field(description=meanings(CostArea)["conductivity"]))}
    table: Any = create_model(f"area_{name}", __base__=table_of(shape, ("shape", name), is_planar), **keys)
    return filled_as(table, lambda conductivity, **keys: CostArea(shape(**keys), conductivity), "shape")


_PLACES = {"point": value_of(GoalPoint), "cell": value_of(GoalCell)}
_START = {
    "point": filled_as(create_model("point", __base__=TableModel, point=fields_from(GoalPoint)["point"]), GoalPoint)
}
KINDS: dict[str, dict[str, Any]] = {
    "obstacle": shape_annotations(SHAPES) | file_annotations(),
    "hidden": shape_annotations(SHAPES),
    "goal": shape_annotations(REGIONS) | _PLACES | JOINT_GOALS | {"position": value_of(GoalPose)},
    "start": _PLACES | _START,
    "area": {name: _area(shape, name, planar) for name, (shape, planar) in SHAPES.items()},
    "robot": {name: value_of(robot, ("type", name)) for name, robot in ROBOTS.items()}
    | {"arm": filled_as(_arm_table(), _arm, "type")},
}
"""Pydantic annotations of tables that have several kinds, by key of the scene file and by kind, such as ``circle``."""


def _checked_kind(key: str, kind: str, kinds: Iterable[str]) -> str:
    """Return `kind`; raise ValueError, whose message names the key `key`, unless `kind` is one of `kinds`."""
    options = list(kinds)
    if kind not in options:
        raise ValueError(unknown_option(f"{key} = {kind!r}", kind, f"one of {', '.join(options)}", options))
    return kind


def _robot_kind(table: Any) -> str:
    kind = table.get("type", "point") if isinstance(table, Mapping) else None
    if not isinstance(kind, str):
        *kinds, last = (f'"{name}"' for name in ROBOTS)
        raise ValueError(f"the robot needs type = {', '.join(kinds)} or {last}")
    return _checked_kind("type", kind, KINDS["robot"])


def _kind_of(name: str, given: Any) -> str:
    """Return the kind of a table, such as ``circle`` or ``cell``; raise ValueError if it has no known kind.

    `name`: key of the scene file that holds the table, such as ``goal``; `given`: the table of a shape or place.
    """
    shapes = [kind for kind in KINDS[name] if kind in SHAPES or kind in READERS]
    places = [kind for kind in KINDS[name] if kind not in shapes]
    if not isinstance(given, Mapping) and places:
        raise ValueError(f"must be a table, such as {{ point = [...] }} or {{ cell = [...] }}, got {short(given)}")
    table = given if isinstance(given, Mapping) else {}
    shape = table.get("shape")
    if isinstance(shape, str) and shape in places:
        remedy = "remove this key" if shape in table else f"write {shape} = [...] instead"
        raise ValueError(f"shape = {shape!r} is not a shape but a key of a place; {remedy}")
    if isinstance(shape, str) and name != "start":
        return _checked_kind("shape", shape, shapes)
    place = next((key for key in places if key in table), None)
    if place is not None:
        return place
    for key in table:
        near = suggestion(str(key), ("shape", *places))
        if near and not any(f"{other!r}" in near for other in table):
            raise ValueError(f"{key!r} is unknown; {near}")
    if name == "start":
        raise ValueError("a start needs point = [...] or cell = [...]")
    extra = ", or point = [...], or cell = [...], or joints = [...]" if places else ""
    raise ValueError(f"needs shape = one of {', '.join(shapes[:-1])} or {shapes[-1]}{extra}")


KIND_OF = {name: partial(_kind_of, name) for name in KINDS} | {"robot": _robot_kind}
"""Functions from a table to the name of its kind, by key of the scene file; they raise ValueError for unknown kinds."""


def _one_of(name: str) -> Any:
    """Return the pydantic annotation of a table that has several kinds; `name`: key of the scene file."""
    kinds = {kind: TypeAdapter(table) for kind, table in KINDS[name].items()}

    def read(table: Any) -> Any:
        return kinds[KIND_OF[name](table)].validate_python(table)

    return Annotated[Any, PlainValidator(read, json_schema_input_type=Union[tuple(KINDS[name].values())])]  # noqa: UP007


def _without_required(schema: dict[str, Any]) -> None:
    """Remove the key ``required`` from a JSON Schema, because a robot may imply the missing keys."""
    schema.pop("required", None)


class _Implied(TableModel):
    """Base of tables whose missing keys the robot may imply."""

    model_config = ConfigDict(json_schema_extra=_without_required)


def _axis(cells: int | None, spacing: float | None, lower: float, upper: float, **keys: Any) -> Axis:
    """Return the axis of a table with either the number of cells or their width; raise ValueError otherwise.

    `cells`: number of cells; `spacing`: width of a cell; exactly one of these two is None; `lower`, `upper`: ends of
    the axis; lengths are in the unit of the axis.
    """
    if (cells is None) == (spacing is None):
        raise ValueError("give either cells or spacing, not " + ("both" if cells else "neither"))
    if spacing is not None and lower < upper:
        count = (upper - lower) / spacing
        if count > 1e18 or round(count) < 1 or abs(count - round(count)) > 1e-6 * max(1.0, count * 1e-3):
            raise ValueError(
                f"spacing = {spacing} does not divide upper - lower = {upper - lower} into whole cells; change one of "
                "them, or give cells"
            )
        cells = round(count)
    return Axis(cells=cells or 1, lower=float(lower), upper=float(upper), **keys)


AxisTable: Any = create_model(
    "AxisTable",
    __base__=_Implied,
    __doc__="One axis of the grid; an arm or a turning polygon supplies the keys that its axes leave out.",
    **fields_from(Axis)
    | {
        "name": (Annotated[str, Len(1)], Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", description="Name, such as x.")),
        "cells": (Count | None, Field(None, description="Number of cells; instead of `spacing`.")),
        "spacing": (Annotated[float, Gt(0)] | None, Field(None, description="Width of a cell; instead of `cells`.")),
    },
)
_AXIS = filled_as(AxisTable, _axis)


class GridTable(_Implied):
    """The grid: its axes, and their numbers of cells; for an arm, ``cells`` is enough."""

    axes: Annotated[list[_AXIS], Len(1, 4), Field(description="The axes, one to four.")]  # type: ignore[valid-type]
    cells: Annotated[
        Annotated[tuple[Count, ...], Strict(False), Len(1, 4), Listed()] | None,
        Field(description="Number of cells of axes without `cells` and `spacing`: one for all, or one per axis."),
    ] = None

    @field_validator("cells")
    @classmethod
    def _is_one_each(cls, cells: tuple[int, ...] | None, info: ValidationInfo) -> tuple[int, ...] | None:
        axes = info.data.get("axes")
        if cells and axes and len(cells) not in (1, len(axes)):
            raise ValueError(f"needs one number for each of the {len(axes)} axes (or one for all), got {len(cells)}")
        return cells


def _checked_format(name: str) -> str:
    names = ["auto", *FORMATS]
    if name not in names:
        raise ValueError(unknown_option(repr(name), name, " or ".join(names), names))
    return name


_FORMAT = Annotated[
    str, AfterValidator(_checked_format), Field(json_schema_extra=lambda schema: schema.update(enum=["auto", *FORMATS]))
]
Map = create_model(
    "Map",
    __base__=TableModel,
    __doc__="A map file in place of a grid, and the options of its reader; each format has options of its own.",
    file=(Annotated[str, Len(1)], Field(description="Name of the file, relative to the scene's folder.")),
    format=(_FORMAT, Field("auto", description="Format of the file; `auto` decides by its suffix or first bytes.")),
    **map_options(),
    periodic=(
        Annotated[tuple[str, ...], Strict(False), Listed()] | None,
        Field(None, description="Names of the periodic axes."),
    ),
    headings=(Count, Field(HEADINGS, description="Number of cells of the heading axis of a robot that turns.")),
)


_ABOUT = meanings(Scene)
_ATTRIBUTES = LISTS | {"start": "starts"}


def _key(name: str, kind: Any, default: Any, *marks: Any, about: str = "") -> tuple[Any, Any]:
    text = about or _ABOUT[_ATTRIBUTES.get(name, name)]
    hint = Annotated[(kind, *marks)] if marks else kind
    return (hint, Field(default, description=text))


def _list_of(name: str, about: str = "") -> tuple[Any, Any]:
    return _key(name, list[_one_of(name)], [], about=about)  # type: ignore[misc]


_EDGES = Annotated[tuple[EdgeRule, ...], Strict(False), Listed()]
SceneFile: Any = create_model(
    "Scene",
    __base__=TableModel,
    __doc__="A resgrid scene.",
    schema_=(Literal[1], Field(alias="schema", description="Version of the file format.")),
    **fields_from(Scene, IN_FILES),
    edge=_key("edge", _EDGES, ("obstacle",)),
    robot=_key("robot", _one_of("robot"), PointRobot()),
    grid=_key("grid", GridTable | None, None, about="The grid; instead of a map."),
    map=_key("map", Map | None, None, about="A map file; instead of a grid."),
    obstacle=_list_of("obstacle"),
    hidden=_list_of("hidden"),
    goal=_list_of("goal"),
    start=_list_of("start", about="Starts as tables, each with a point in world coordinates or a cell."),
    starts=_key("starts", list[Coordinates], []),
    area=_list_of("area"),
)
_ROBOT: TypeAdapter[Robot] = TypeAdapter(_one_of("robot"))
TABLES: dict[str, Any] = {
    "": SceneFile,
    "links": Link,
    "grid": GridTable,
    "axes": AxisTable,
    "map": Map,
    "mask": table_of(Mask),
    "chip": table_of(Chip),
    "control": table_of(Control),
    "readout": table_of(Readout),
    "defects": table_of(Defects),
}


def keys_of(path: tuple[str | int, ...], kind: str | None) -> list[str]:
    """Return the allowed keys of the table at a key path, empty if there is no such table.

    `path`: names and indices, empty for the top level; `kind`: kind of the table, None if there is one kind only.
    """
    name = next((part for part in reversed(path) if isinstance(part, str)), "")
    table: Any = TABLES.get(name) or (KINDS[name][kind].__origin__ if kind in KINDS.get(name, {}) else None)
    return [] if table is None else [field.alias or key for key, field in table.model_fields.items()]


def validate(raw: Mapping[str, Any]) -> tuple[Any, list[Problem], dict[Path, Any]]:
    """Return the typed document of a scene file, a list of problems, and the valid entries of its lists by key path.

    A problem is a pair of key path, such as ``("obstacle", 2, "radius")``, and message.  `raw`: keys and tables of the
    file.  The typed document omits invalid entries, so that the valid ones can still be checked for consistency.
    """
    numbers = {key: [*range(len(raw[key]))] for key in (*KINDS, "starts") if isinstance(raw.get(key), list)}
    problems: list[Problem] = []
    try:
        document = SceneFile.model_validate(dict(raw))
    except ValidationError as error:
        problems = [(_path_in(raw, where), text) for where, text in problems_of(error, partial(_message, raw=raw))]
        wrong = {path[: 2 if path[0] in numbers else 1] for path, _ in problems if path}
        valid = {key: value for key, value in raw.items() if (key,) not in wrong} | {"schema": 1}
        numbers = {key: [n for n in every if (key, n) not in wrong] for key, every in numbers.items() if key in valid}
        valid |= {key: [raw[key][n] for n in some] for key, some in numbers.items()}
        document = SceneFile.model_validate(valid)
    entries = ((key, zip(some, getattr(document, key), strict=True)) for key, some in numbers.items())
    return document, problems, {(key, number): value for key, pairs in entries for number, value in pairs}


def _message(detail: ErrorDetails, raw: Mapping[str, Any]) -> str:
    """Return the message for one of pydantic's errors; for an unknown key, the message names the nearest known key.

    `detail`: the error; `raw`: keys and tables of the document.
    """
    is_unknown = detail["type"] == "extra_forbidden"
    return _unknown_key(_path_in(raw, detail["loc"]), raw) if is_unknown else message_of(detail)


def _path_in(raw: Any, location: Path) -> Path:
    """Return the leading part of pydantic's location of an error that is a key path of the document `raw`."""
    node = raw
    for depth, part in enumerate(location):
        if not isinstance(node, Mapping | list):
            return location[:depth]
        node = node.get(str(part)) if isinstance(node, Mapping) else node[int(part)]
    return location


def _unknown_key(path: Path, raw: Any) -> str:
    """Return the message for an unknown key: the key of the nearest spelling, its table, or all allowed keys.

    `path`: key path of the unknown key; `raw`: keys and tables of the document.
    """
    kind = None  # of a table that has several kinds
    if path[0] in KIND_OF and len(path) == (2 if path[0] == "robot" else 3):
        kind = KIND_OF[str(path[0])](raw["robot"] if path[0] == "robot" else raw[path[0]][path[1]])
    name, known = str(path[-1]), keys_of(path[:-1], kind)
    near = suggestion(name, known)
    if near:
        return f"unknown key; {near}"
    if len(path) > 1 and name in keys_of((), None):
        return f"this key belongs at the top level of the scene, above the first [table]; move {name!r} there"
    if kind is not None and len(known) == 1:  # a place
        return f"no other key goes with {known[0]} = [...]; remove {name!r}"
    whose = "" if kind is None else f" of {'an' if kind[0] in 'aeiou' else 'a'} {kind.replace('_', '-')}"
    return f"unknown key{whose}; the keys are {', '.join(known)}" if known else "unknown key; remove it"


def robot_of(table: Any) -> Robot | None:
    """Return the robot that a ``[robot]`` table describes; None if the table is invalid."""
    try:
        return _ROBOT.validate_python(table)
    except ValueError:
        return None


def scene_schema() -> dict[str, Any]:
    """Return the JSON Schema of scene files.

    Returns
    -------
    dict
        JSON Schema, draft 2020-12.

    Examples
    --------
    >>> schema = rg.scene_schema()
    >>> schema["title"], "obstacle" in schema["properties"]
    ('Scene', True)
    """
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **SceneFile.model_json_schema(by_alias=True)}
