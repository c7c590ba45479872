"""Types of options and arguments of the command line, with validation and shell completion."""

from __future__ import annotations

import glob
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from resgrid._internal.files import target_of
from resgrid.errors import InputError

if TYPE_CHECKING:
    _Type = click.ParamType[Any]
else:
    _Type = click.ParamType


def _example(param: click.Parameter | None) -> str:
    """Return a description and an example of an option's numbers as text, for messages.

    The metavars ``K`` (weights) and ``X,Y`` (a place) of the option `param` have texts of their own.
    """
    metavar = (param.metavar if isinstance(param, click.Option) else None) or ""
    if metavar == "K":
        return "a number from 0 to 1, such as 0.9, or several separated by commas"
    if metavar == "X,Y":
        return "numbers separated by commas, such as 3,4"
    return "one number, or numbers separated by commas, such as 0.5,1"


class Numbers(_Type):
    """Type of an option that consists of finite numbers, separated by commas."""

    name = "numbers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:  # noqa: ARG002
        """Return the finite numbers of a text such as "3,4", or a tuple unchanged; raise InputError for other texts."""
        if isinstance(value, tuple):
            return value
        option = param.opts[0] if param else "numbers"
        try:
            numbers = tuple(float(word) for word in value.split(","))
        except ValueError:
            raise InputError(f"{option} {value!r}: expected {_example(param)}") from None
        if not all(abs(number) < float("inf") for number in numbers):
            raise InputError(f"{option} {value!r}: expected finite numbers")
        return numbers


class Region(Numbers):
    """Type of the option ``--crop``: the word ``known`` (smallest box with all known cells), or a box as numbers.

    The numbers, separated by commas, are the coordinates of the lower corner, then those of the upper corner, in world
    coordinates.
    """

    name = "region"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the word ``known``, or the finite numbers of a text such as ``"0,0,2.5,1"``.

        Raises InputError for other texts. The number of coordinates is checked later, when the axes are known.
        """
        if isinstance(value, str) and value.strip().isalpha():
            if value.strip() != "known":
                raise InputError(f"--crop {value!r}: expected known, or the corners of a box X0,Y0,X1,Y1")
            return "known"
        return super().convert(value, param, ctx)


class Number(_Type):
    """Type of an option that is a finite number; `remedy`: end of the error message for a text without a number."""

    name = "number"

    def __init__(self, remedy: str = "give a number without unit, such as 0.2") -> None:
        self.remedy = remedy

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number of a text in Python's notation, such as ``"0.2"`` or ``"1e-3"``, without unit or prefix.

        Raises click's BadParameter for any other text, infinity and NaN.
        """
        try:
            number = float(value)
        except ValueError:
            self.fail(f"{value!r} is not a number; {self.remedy}", param, ctx)
        if not abs(number) < float("inf"):
            self.fail(f"{value!r} is not finite; {self.remedy}", param, ctx)
        return number


class NumberRange(click.FloatRange):
    """Type of an option that is a finite number within limits, which are arguments of click's FloatRange."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number of a text; raise click's BadParameter for other texts or numbers outside the limits."""
        return super().convert(Number().convert(value, param, ctx), param, ctx)


def fraction_below(limit: float) -> NumberRange:
    """Return the type of an option that is a number between 0 and `limit`, both excluded."""
    return NumberRange(0, limit, min_open=True, max_open=True)


class Suggested(_Type):
    """Type of an option that is a word, which the library validates.

    `name`: name of the type in help texts; `words`: words that the shell completes.  The option accepts any text, so
    that the library can raise an error with a suggestion.
    """

    def __init__(self, name: str, *words: str) -> None:
        self.name, self.words = name, words

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Return the completions: the words of this type that begin with the text `incomplete`.

        The words are those given to the constructor; the option also accepts words that the shell does not complete.
        """
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]


class SceneKey(_Type):
    """Type of the option ``--set``: ``KEY=VALUE``, where the key is a path in a scene file (``chip.resistance``).

    The shell completes a key path one table at a time.
    """

    name = "text"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Return completed key paths that begin with `incomplete` and end with a point (table) or an equals sign."""
        from resgrid.scene.schema import keys_of

        *tables, begin = incomplete.split(".")
        paths = [(*tables, key) for key in keys_of(tuple(tables), None) if key.startswith(begin)]
        return [CompletionItem(".".join(path) + ("." if keys_of(path, None) else "=")) for path in paths]


class OutputPath(click.Path):
    """Type of an option that is an output file or folder, checked for writing before the computation."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:  # noqa: ARG002
        """Return the name of the output; raise InputError for an empty name or a file that cannot be written.

        An option that may be a folder is only tested for an empty name.  The name ``-`` (standard output) is accepted.
        """
        if not value.strip():
            option = param.opts[0] if param else "the output"
            raise InputError(f"{option}: the name is empty; give a file name, or - for standard output")
        if value != "-" and not self.dir_okay:
            target_of(Path(value))
        return str(value)


class SourceName(click.Path):
    """Type of an argument that is the name of a scene, a map or a deck, with shell completion."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the files and the shipped scenes whose names begin with the text `incomplete`.

        The shell completes only files if no shipped scene matches, or if the text is empty and the folder has files.
        """
        from resgrid.scene.shipped import shipped_scenes

        shipped = [name for name in shipped_scenes() if name.startswith(incomplete)]
        local = sorted(path for path in Path().glob(f"{glob.escape(incomplete)}*") if not path.name.startswith("."))
        if not shipped or (local and not incomplete):
            return super().shell_complete(ctx, param, incomplete)
        names = [f"{path}/" if path.is_dir() else str(path) for path in local]
        return [CompletionItem(name) for name in dict.fromkeys([*names, *shipped])]
