"""A raw scene document checked as a whole: every error at once, with its key path, its line and a remedy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from resgrid.scene.messages import complaint, suggestion
from resgrid.scene.schema import KINDS, SceneFile, keys_of
from resgrid.scene.table import problems_of
from resgrid.scene.toml_lines import Path

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

Problem = tuple[Path, str]
_PLACES = {"goal": ("point", "cell", "joints", "joints_lower"), "start": ("point", "cell")}


def validate(raw: Mapping[str, Any]) -> tuple[Any, list[Problem], dict[str, list[int]]]:
    """The typed document, what is wrong with it, and the numbers of the list entries that are in it.

    What is wrong is left out of the document, so that what is right can still be checked for consistency.
    """
    try:
        return SceneFile.model_validate(dict(raw)), [], _numbers(raw)
    except ValidationError as error:
        problems = [_problem(detail, raw) for detail in problems_of(error)]
    wrong = {path[: 2 if path[0] in KINDS or path[0] == "starts" else 1] for path, _ in problems if path}
    sound = {key: value for key, value in raw.items() if (key,) not in wrong} | {"schema": 1}
    numbers = _numbers(sound)
    for key in numbers:
        numbers[key] = [number for number in numbers[key] if (key, number) not in wrong]
        sound[key] = [sound[key][number] for number in numbers[key]]
    if any(path[:1] == ("robot",) for path in wrong):
        sound.pop("robot", None)
    return SceneFile.model_validate(sound), problems, numbers


def _numbers(raw: Mapping[str, Any]) -> dict[str, list[int]]:
    lists = (*KINDS, "starts")
    return {key: list(range(len(raw[key]))) for key in lists if isinstance(raw.get(key), list)}


def _problem(detail: ErrorDetails, raw: Mapping[str, Any]) -> Problem:
    location = detail["loc"]
    tag = _tag_at(location)
    path = _without_tags(location, raw, detail["type"], tag)
    kind = None if tag is None else str(location[tag])
    match detail["type"]:
        case "extra_forbidden":
            return path, _unknown_key(path, kind)
        case "union_tag_invalid":
            return path, _unknown_kind(detail, path)
        case "union_tag_not_found":
            return path, _no_kind(detail, path)
    return path, complaint(detail)


def _tag_at(location: tuple[int | str, ...]) -> int | None:
    """Where pydantic's location names the kind of a table instead of a key, such as 1 in ("robot", "arm", ...)."""
    if not location or location[0] not in KINDS:
        return None
    at = 1 if location[0] == "robot" else 2
    return at if at < len(location) else None


def _without_tags(location: tuple[int | str, ...], raw: Any, error: str, tag: int | None) -> Path:
    """Pydantic's location without what is no key of the document: names of unions' members."""
    path: list[str | int] = []
    node = raw
    for position, part in enumerate(location):
        if position == tag:
            continue
        last = position == len(location) - 1
        if isinstance(node, Mapping) and part in node:
            node = node[str(part)]
        elif isinstance(node, list) and isinstance(part, int) and part < len(node):
            node = node[part]
        elif not (last and error == "missing"):
            continue
        path.append(part)
    return tuple(path)


def _unknown_key(path: Path, kind: str | None) -> str:
    name, known = str(path[-1]), keys_of(path[:-1], kind)
    near = suggestion(name, known)
    if near:
        return f"unknown key; {near}"
    if len(path) > 1 and name in keys_of((), None):
        return f"this key belongs at the top level of the scene, above the first [table]; move {name!r} there"
    if kind is not None and len(known) == 1:  # a place
        return f"nothing else goes with {known[0]} = [...]; remove {name!r}"
    whose = "" if kind is None else f" of {'an' if kind[0] in 'aeiou' else 'a'} {kind.replace('_', '-')}"
    return f"unknown key{whose}; there are {', '.join(known)}" if known else "unknown key; remove it"


def _unknown_kind(detail: ErrorDetails, path: Path) -> str:
    kind = str(detail["ctx"]["tag"])
    places = _PLACES.get(str(path[0]), ())
    options = [option for option in KINDS[str(path[0])] if option not in places]
    near = suggestion(kind, options)
    key = "type" if path == ("robot",) else "shape"
    return f"{key} = {kind!r} is unknown: it may be one of {', '.join(options)}{near and f'; {near}'}"


def _no_kind(detail: ErrorDetails, path: Path) -> str:
    if path[:1] == ("robot",):
        *kinds, last = (f'"{kind}"' for kind in KINDS["robot"])
        return f"the robot needs type = {', '.join(kinds)} or {last}"
    places = _PLACES.get(str(path[0]), ())
    table = detail["input"] if isinstance(detail["input"], Mapping) else {}
    shape = table.get("shape")
    if shape in places:
        remedy = "remove this key" if shape in table else f"write {shape} = [...] instead"
        return f"shape = {shape!r} is no shape, for a place needs none; {remedy}"
    for name in table:
        near = suggestion(str(name), ("shape", *places))
        if near and not any(f"{key!r}" in near for key in table):
            return f"{name!r} is unknown; {near}"
    if path[:1] == ("start",):
        return "a start needs point = [...] or cell = [...]"
    extra = ", or point = [...], or cell = [...], or joints = [...]" if places else ""
    return f"this needs shape = one of rectangle, circle, polygon, box, sphere or half_plane{extra}"
