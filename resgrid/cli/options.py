"""Options that verbs share: what stands in for a scene's keys, how maps are read, where results go; help in groups."""

from __future__ import annotations

import functools
import glob
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from resgrid._internal.files import target_of
from resgrid.cli.terminal import Verbosity, require_one_output
from resgrid.errors import InputError
from resgrid.spice.dialects import DIALECTS

if TYPE_CHECKING:
    _Type = click.ParamType[Any]
else:
    _Type = click.ParamType

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def _example(param: click.Parameter | None) -> str:
    """Return the expected form of an option's numbers, by its metavar: X,Y for places, K for blends."""
    metavar = (param.metavar if isinstance(param, click.Option) else None) or ""
    if metavar == "K":
        return "a number from 0 to 1, such as 0.9, or several separated by commas"
    if metavar == "X,Y":
        return "numbers separated by commas, such as 3,4"
    return "one number, or numbers separated by commas, such as 0.5,1"


class Numbers(_Type):
    """Finite numbers with commas; one number is a list of one."""

    name = "numbers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:  # noqa: ARG002
        """The numbers of a text."""
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


class Amount(click.FloatRange):
    """A finite number within limits."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number of a text."""
        number = super().convert(value, param, ctx)
        if not abs(number) < float("inf"):
            self.fail(f"{value} is not finite", param, ctx)
        return number


def share(below: float) -> Amount:
    """A number between 0 and a limit, neither of them included."""
    return Amount(0, below, min_open=True, max_open=True)


class Suggested(_Type):
    """A word that the scene's schema knows better than the command line; usual ones are completed."""

    def __init__(self, name: str, *words: str) -> None:
        self.name, self.words = name, words

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Usual words that begin so."""
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]


class SceneKey(_Type):
    """A key of a scene and its value, as ``--set`` takes them; keys are completed, table by table."""

    name = "text"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Keys that begin so: of tables with a point behind them, of values with an equals sign."""
        from resgrid.scene.schema import keys_of

        *tables, begin = incomplete.split(".")
        paths = [(*tables, key) for key in keys_of(tuple(tables), None) if key.startswith(begin)]
        return [CompletionItem(".".join(path) + ("." if keys_of(path, None) else "=")) for path in paths]


class Shared(click.Option):
    """An option that many verbs have; help shows it in a group."""

    def __init__(self, *names: Any, group: str, **options: Any) -> None:
        super().__init__(*names, **options)
        self.group = group


class Verb(click.Command):
    """A command whose help shows its own options first, the shared ones in groups, and examples."""

    def __init__(self, *arguments: Any, examples: Sequence[str] = (), **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.examples = examples

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write options group by group."""
        groups: dict[str, list[tuple[str, str]]] = {title: [] for title in ("Options", OUTPUT, KEYS, MAP, DECK)}
        for parameter in sorted(self.get_params(ctx), key=lambda parameter: parameter.name != "output"):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None:
                plain = OUTPUT if "--help" in parameter.opts else "Options"
                groups[getattr(parameter, "group", plain)].append(record)
        for title, records in groups.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples."""
        super().format_epilog(ctx, formatter)
        with formatter.section("Examples"):
            for example in self.examples:
                formatter.write(f"  {example}\n")


class Written(click.Path):
    """What results go to; a file that cannot be written is refused before anything is computed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:  # noqa: ARG002
        """The name as it stands."""
        if not value.strip():
            option = param.opts[0] if param else "the output"
            raise InputError(f"{option}: the name is empty; name a file, or - for standard output")
        if value != "-" and not self.dir_okay:
            target_of(Path(value))
        return str(value)


class SourceName(click.Path):
    """The name of a scene, a map or a deck; files and shipped scenes are completed."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return shipped scenes and local files that begin so, or leave files to the shell."""
        from resgrid.scene.shipped import shipped_scenes

        shipped = [name for name in shipped_scenes() if name.startswith(incomplete)]
        local = sorted(path for path in Path().glob(f"{glob.escape(incomplete)}*") if not path.name.startswith("."))
        if not shipped or (local and not incomplete):
            return super().shell_complete(ctx, param, incomplete)
        names = [f"{path}/" if path.is_dir() else str(path) for path in local]
        return [CompletionItem(name) for name in dict.fromkeys([*names, *shipped])]


def is_source(word: str) -> bool:
    """Return whether a word names a scene, a map or a deck: a file, a link of the live page, or a shipped scene."""
    from resgrid.scene.shipped import shipped_scene

    path = Path(word)
    return "://" in word or path.is_file() or bool(path.suffix) or shipped_scene(word) is not None


SOURCE = SourceName(path_type=str, allow_dash=True)
WRITTEN, FOLDER = Written(dir_okay=False), Written()
NUMBERS = Numbers()
POSITIVE = Amount(0, min_open=True)
OUTPUT, KEYS, MAP, DECK = "Output", "In place of the scene's keys", "Of a map", "Of a deck"

_output, _key, _map, _deck = (partial(click.option, cls=Shared, group=group) for group in (OUTPUT, KEYS, MAP, DECK))
_REPORT_OPTIONS: tuple[Decorator, ...] = (
    _output("--json", "as_json", is_flag=True, help="Print one JSON object on standard output."),
    _output("-q", "--quiet", is_flag=True, help="Print no messages but errors."),
    _output("-v", "--verbose", is_flag=True, help="Print each stage and how long it took."),
    _output("--debug", is_flag=True, help="Show the traceback of a fault of resgrid itself."),
)
_SCENE_OPTIONS: tuple[Decorator, ...] = (
    _key("--boundary", type=Suggested("rule", "dirichlet", "neumann", "wall"),
         help="What obstacles are: dirichlet (a rail), neumann (open) or wall (a rail behind a resistance)."),
    _key("--drive", type=Suggested("drive", "uniform", "start"),
         help="What drives open obstacles: uniform (a current into every free cell) or start (the start on a rail)."),
    _key("--edge", type=Suggested("rule", "obstacle", "open"),
         help="The grid's border: obstacle or open; one per axis with commas."),
    _key("--resistance", metavar="OHMS", help="Resistance between neighbours, such as 10k."),
    _key("--goal", metavar="X,Y", type=NUMBERS, multiple=True, help="Goal, in world coordinates; repeatable."),
    _key("--start", metavar="X,Y", type=NUMBERS, multiple=True, help="Start, likewise; repeatable."),
    _key("--cells", is_flag=True, help="Goals and starts are cell indices, not world coordinates."),
    _key("--robot-radius", metavar="R", type=float, help="Radius of the robot, a disc."),
    _key("--k", metavar="K", type=NUMBERS, multiple=True,
         help="Share of the Dirichlet field, 1: away from obstacles, 0: past them (Neumann); repeatable."),
    _key("--set", "settings", metavar="KEY=VALUE", type=SceneKey(), multiple=True,
         help="Any other key, such as chip.supply=3."),
    _key("--threads", metavar="N", type=click.IntRange(1), default=1, help="Most threads; small circuits use one."),
    _map("--format", type=Suggested("name", "ros", "movingai", "voxels", "image", "epic", "npy"),
         help="ros, movingai, voxels, image, epic or npy, where the name hides it."),
    _map("--map-dialect", "dialect_", type=Suggested("name", "nav2", "nav2-jazzy", "ros1"),
         help="Read a ROS map as nav2 (since 2025), nav2-jazzy (before) or ros1.  [default: nav2]"),
    _map("--unknown", type=Suggested("policy", "obstacle", "free"), help="Unseen ROS cells: obstacle or free."),
    _map("--lethal", metavar="N", type=int, help="ROS occupancy (1 to 100) from which a cell is an obstacle."),
    _map("--passable", metavar="LETTERS", help="MovingAI terrain that is free, such as '.GS'."),
    _map("--threshold", metavar="N", type=int, help="Grey values of a picture from here on are free."),
    _map("--spacing", metavar="H", type=float, help="Width of a cell, where the map does not say."),
    _map("--origin", metavar="X,Y", type=NUMBERS, help="Lower corner, where the map does not say."),
    _map("--unit", metavar="NAME", help="Unit of lengths, where the map does not say."),
)  # fmt: skip
_DECK_OPTIONS: tuple[Decorator, ...] = (
    _deck("--read-as", type=Suggested("dialect", "auto", *DIALECTS), default="auto",
          help="The deck's dialect, where it does not show it; of a deck that is piped in (-), always."),
    _deck("--root", metavar="FOLDER", type=click.Path(),
          help="Where its includes may lie.  [default: the deck's folder]"),
)  # fmt: skip


@dataclass(frozen=True)
class CommandInput:
    """What a verb works on, and how it is read.

    `file`: name, or ``-``; `map_options`: for `read_scene`; `changes`: of the scene's keys, for `apply_overrides`;
    `threads`: for `solve`; `dialect, root`: for `read_spice`.
    """

    file: str
    map_options: Mapping[str, Any]
    changes: Mapping[str, Any]
    threads: int = 1
    dialect: str = "auto"
    root: str | None = None


def verb(name: str, *, examples: Sequence[str]) -> Decorator:
    """Make a command of a function, with the options that say how results are reported."""

    def decorate(function: Callable[..., Any]) -> click.Command:
        @functools.wraps(function)
        @click.pass_context
        def reporting(
            ctx: click.Context, /, as_json: bool, quiet: bool, verbose: bool, debug: bool, **values: Any
        ) -> Any:
            del debug  # read by the group, where errors end
            ctx.obj = Verbosity(json=as_json, quiet=quiet, verbose=verbose)
            require_one_output(values.get("output"))
            return function(**values)

        command = click.command(name, cls=Verb, examples=examples, context_settings={"show_default": True})
        return command(_decorated(reporting, _REPORT_OPTIONS))

    return decorate


def with_source(metavar: str = "SCENE", *, required: bool = True) -> Decorator:
    """Give a verb what it works on and the shared options, bundled as ``source`` (None where it is left out)."""
    options = (*_SCENE_OPTIONS, *(_DECK_OPTIONS if "DECK" in metavar else ()))

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def bundled(file: str | None, **values: Any) -> Any:
            given: dict[str, dict[str, Any]] = {KEYS: {}, MAP: {}, DECK: {}}
            for option in click.get_current_context().command.params:
                name = option.name or ""
                if isinstance(option, Shared) and option.group in given:
                    given[option.group][name] = values.pop(name)
                elif isinstance(option.type, Written) and file is not None:
                    _require_another(option.opts[0], values[name], file)
            return function(source=None if file is None else _source(file, *given.values()), **values)

        return click.argument("file", metavar=metavar, type=SOURCE, required=required)(_decorated(bundled, options))

    return decorate


def _require_another(option: str, output: str | None, file: str) -> None:
    """Refuse to write over what is read."""
    if output is not None and Path(output).exists() and Path(file).exists() and Path(output).samefile(file):
        raise InputError(f"{option} {output}: this is the input; name another file")


def output_option(help_text: str, *, required: bool = False, of_folder: bool = False) -> Decorator:
    """The option ``-o``."""
    metavar, kind = ("DIR", FOLDER) if of_folder else ("FILE", WRITTEN)
    return _output("-o", "--output", metavar=metavar, type=kind, required=required, help=help_text)


def with_method(function: Callable[..., Any]) -> Callable[..., Any]:
    """The options ``--method``, ``--ranks`` and ``--launcher``, of subcommands that solve one circuit."""
    options = (
        click.option("--method", type=click.Choice(["auto", "direct", "multigrid", "petsc"]), default="auto",
                     help="How to solve; petsc is for grids that do not fit otherwise."),
        click.option("--ranks", metavar="N", type=click.IntRange(1), help="Processes of --method petsc.  [default: 2]"),
        click.option("--launcher", metavar="COMMAND",
                     help="Command that starts the processes of --method petsc in place of mpiexec and --ranks, their "
                     "number included: 'srun -n 64'. All computers must share the folder for files (TMPDIR)."),
    )  # fmt: skip
    return _decorated(function, options)


def folder_of(output: str | None, source: CommandInput, end: str = "") -> Path:
    """The folder that many results go to: the one that is named, or one after the source."""
    if output == "-":
        raise InputError("-o -: the results are many files; name a folder")
    stem = "scene" if source.file == "-" or "://" in source.file else Path(source.file).stem
    name = re.sub(r"[^\w.-]+", "_", stem).strip(".") or "scene"
    return Path(output) if output else Path("out") / f"{name}{end}"


def dialect_option(default: str | None = "ngspice") -> Decorator:
    """The option ``--dialect``, of decks that are written."""
    return click.option(
        "--dialect", type=Suggested("dialect", *DIALECTS), default=default,
        help=f"SPICE dialect of the deck: {', '.join(DIALECTS)}.",
    )  # fmt: skip


def _source(file: str, keys: dict[str, Any], of_map: Mapping[str, Any], of_deck: Mapping[str, Any]) -> CommandInput:
    """Sort the values of the shared options into map options and changes of the scene."""
    changes = {key: keys[key] for key in ("boundary", "drive", "edge", "resistance") if keys[key] is not None}
    for key in ("goal", "start"):
        if keys[key]:
            changes |= _cells(key, keys[key]) if keys["cells"] else {key: list(keys[key])}
    if keys["k"]:
        changes["k"] = [share for shares in keys["k"] for share in shares]
    if keys["robot_radius"] is not None:
        changes["robot.radius"] = keys["robot_radius"]
    for setting in keys["settings"]:
        key, equals, value = (part.strip() for part in setting.partition("="))
        if not equals or not key:
            raise InputError(f"--set {setting!r}: expected KEY=VALUE, such as chip.supply=3.3")
        if changes.setdefault(key, value) != value:
            raise InputError(f"--set {setting}: {key} is also given as {_shown(changes[key])}; leave one of them out")
    if "boundary" in changes:  # the scene's blends and drive belong to its own boundary
        changes.setdefault("k", [])
        if changes["boundary"] != "neumann":
            changes.setdefault("drive", None)
    options = {key.rstrip("_"): value for key, value in of_map.items() if value is not None}
    reading = {"dialect": of_deck.get("read_as", "auto"), "root": of_deck.get("root")}
    return CommandInput(file, options, changes, keys["threads"], **reading)


def _shown(value: Any) -> str:
    """Return a changed value as one types it."""
    return ",".join(map(_shown, value)) if isinstance(value, list | tuple) else f"{value}"


def _cells(key: str, places: Sequence[tuple[float, ...]]) -> dict[str, list[tuple[int, ...]]]:
    """Cell indices in place of world coordinates."""
    for place in places:
        if not all(number.is_integer() for number in place):
            text = ",".join(f"{number:g}" for number in place)
            raise InputError(f"--{key} {text}: with --cells expected whole numbers (cell indices), such as 3,4")
    return {f"{key}_cell": [tuple(int(number) for number in place) for place in places]}


def _decorated(function: Callable[..., Any], options: Sequence[Decorator]) -> Callable[..., Any]:
    for option in reversed(options):
        function = option(function)
    return function
