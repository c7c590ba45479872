"""A raw scene document checked as a whole: every error at once, with its key path, its line and a remedy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from resgrid.scene.messages import Problem, complaint, suggestion
from resgrid.scene.schema import KIND_OF, KINDS, SceneFile, keys_of
from resgrid.scene.table import problems_of
from resgrid.scene.toml_lines import Path

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails


def validate(raw: Mapping[str, Any]) -> tuple[Any, list[Problem], dict[Path, Any]]:
    """The typed document, what is wrong with it, and the entries of its lists by their key paths.

    What is wrong is left out of the document, so that what is right can still be checked for consistency.
    """
    numbers = {key: [*range(len(raw[key]))] for key in (*KINDS, "starts") if isinstance(raw.get(key), list)}
    problems: list[Problem] = []
    try:
        document = SceneFile.model_validate(dict(raw))
    except ValidationError as error:
        problems = [_problem(detail, raw) for detail in problems_of(error)]
        wrong = {path[: 2 if path[0] in numbers else 1] for path, _ in problems if path}
        sound = {key: value for key, value in raw.items() if (key,) not in wrong} | {"schema": 1}
        numbers = {key: [n for n in every if (key, n) not in wrong] for key, every in numbers.items() if key in sound}
        sound |= {key: [raw[key][n] for n in some] for key, some in numbers.items()}
        document = SceneFile.model_validate(sound)
    entries = ((key, zip(some, getattr(document, key), strict=True)) for key, some in numbers.items())
    return document, problems, {(key, number): value for key, pairs in entries for number, value in pairs}


def _problem(detail: ErrorDetails, raw: Mapping[str, Any]) -> Problem:
    path = _path_in(raw, detail["loc"])
    return path, _unknown_key(path, raw) if detail["type"] == "extra_forbidden" else complaint(detail)


def _path_in(raw: Any, location: Path) -> Path:
    """Pydantic's location as the document has it, where the only entry of a list may stand without one."""
    node = raw
    for depth, part in enumerate(location):
        if not isinstance(node, Mapping | list):
            return location[:depth]
        node = node.get(str(part)) if isinstance(node, Mapping) else node[int(part)]
    return location


def _unknown_key(path: Path, raw: Any) -> str:
    kind = None  # of a table that comes in several
    if path[0] in KIND_OF and len(path) == (2 if path[0] == "robot" else 3):
        kind = KIND_OF[str(path[0])](raw["robot"] if path[0] == "robot" else raw[path[0]][path[1]])
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
