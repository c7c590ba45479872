"""Options that subcommands have in common (scene keys, maps, decks, output), and grouped help."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from resgrid.cli.option_types import (
    Number,
    NumberRange,
    Numbers,
    OutputPath,
    Region,
    SceneKey,
    SourceName,
    Suggested,
)
from resgrid.cli.streams import STANDARD_INPUT
from resgrid.cli.terminal import Verbosity, require_one_output
from resgrid.errors import InputError
from resgrid.spice.dialects import DIALECTS

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


class SharedOption(click.Option):
    """An option that many subcommands have; `group`: title of the section of help texts that lists the option."""

    def __init__(self, *names: Any, group: str, **options: Any) -> None:
        super().__init__(*names, **options)
        self.group = group


class Subcommand(click.Command):
    """A subcommand whose help lists its own options, groups of shared options, and `examples` (command lines)."""

    def __init__(self, *arguments: Any, examples: Sequence[str] = (), **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.examples = examples

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sections of options of the help text: own options first, then each group of shared options."""
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
        """Write the section of examples at the end of the help text."""
        super().format_epilog(ctx, formatter)
        with formatter.section("Examples"):
            for example in self.examples:
                formatter.write(f"  {example}\n")


def is_source(word: str) -> bool:
    """Return whether a word has the form of an input of a subcommand.

    Such words are existing files, names with a suffix, links of the live page, and names of shipped scenes.
    """
    from resgrid.scene.shipped import shipped_scene

    path = Path(word)
    return "://" in word or path.is_file() or bool(path.suffix) or shipped_scene(word) is not None


SOURCE = SourceName(path_type=str, allow_dash=True)
OUTPUT_FILE, OUTPUT_FOLDER = OutputPath(dir_okay=False), OutputPath()
NUMBERS, REGION = Numbers(), Region()
POSITIVE = NumberRange(0, min_open=True)
OUTPUT, KEYS, MAP, DECK = "Output", "Scene keys", "Map options", "Deck options"
"""Titles of the groups of shared options."""

_output, _key, _map, _deck = (
    partial(click.option, cls=SharedOption, group=group) for group in (OUTPUT, KEYS, MAP, DECK)
)
_REPORT_OPTIONS: tuple[Decorator, ...] = (
    _output("--json", "as_json", is_flag=True, help="Print one JSON object on standard output."),
    _output("-q", "--quiet", is_flag=True, help="Print no messages except errors."),
    _output("-v", "--verbose", is_flag=True, help="Print the time of every stage."),
    _output("--debug", is_flag=True, help="Print the traceback of an internal error."),
)
_SCENE_OPTIONS: tuple[Decorator, ...] = (
    _key("--boundary", type=Suggested("rule", "dirichlet", "neumann", "wall"),
         help="Boundary condition at obstacles: dirichlet (rail), neumann (open) or wall (rail through a resistance)."),
    _key("--drive", type=Suggested("drive", "uniform", "start"),
         help="Drive with open obstacles: uniform (a current into every free cell) or start (start on the high rail)."),
    _key("--edge", type=Suggested("rule", "obstacle", "open"),
         help="Border of the grid: obstacle or open; separated by commas for one per axis."),
    _key("--leak", metavar="L",
         help="Leak of every free cell to the obstacle rail, in 1 / (unit of the axes)^2: 1 / (screening length)^2."),
    _key("--lattice", type=Suggested("lattice", "square", "square8", "cube26", "hexagonal"),
         help="Neighbours of a node: square (faces of cells), square8 or cube26 (also corners), or hexagonal (six)."),
    _key("--resistance", metavar="OHMS", help="Resistance between neighbours, such as 10k."),
    _key("--goal", metavar="X,Y", type=NUMBERS, multiple=True,
         help="Goal in world coordinates (X,Y,Z in space); repeatable."),
    _key("--goal-tolerance", metavar="R", type=NumberRange(0),
         help="Largest distance from a goal point at which the goal is reached, in the unit of the axes."),
    _key("--start", metavar="X,Y", type=NUMBERS, multiple=True,
         help="Start in world coordinates (X,Y,Z in space); repeatable."),
    _key("--cells", is_flag=True, help="Goals and starts are cell indices instead of world coordinates."),
    _key("--robot-radius", metavar="R",
         type=Number("give a number in the unit of the axes, such as 0.2 for 20 cm on axes in metres"),
         help="Radius of a disc-shaped robot (a ball in space), in the unit of the axes."),
    _key("--k", metavar="K", type=NUMBERS, multiple=True,
         help="Weight of the Dirichlet field: 1 leads away from obstacles, 0 (Neumann) along them; repeatable."),
    _key("--set", "settings", metavar="KEY=VALUE", type=SceneKey(), multiple=True,
         help="Value of any other key, such as chip.supply=3."),
    _key("--threads", metavar="N", type=click.IntRange(1), default=1,
         help="Largest number of threads; small circuits use one."),
    _map("--format",
         type=Suggested("name", "ros", "movingai", "voxels", "octomap", "point_cloud", "image", "epic", "npy"),
         help="Format, if the file name does not show it: ros, movingai, voxels, octomap, point_cloud, image, epic or "
         "npy."),
    _map("--map-dialect", "dialect_", type=Suggested("name", "nav2", "nav2-jazzy", "ros1"),
         help="Reader of ROS maps: nav2 (since 2025), nav2-jazzy (before) or ros1.  [default: nav2]"),
    _map("--unknown", type=Suggested("policy", "obstacle", "free"),
         help="Unknown cells of ROS maps and OctoMaps: obstacle or free."),
    _map("--occupied", metavar="P", type=Number("give a probability between 0 and 1, such as 0.6"),
         help="Smallest probability of an occupied voxel of an OctoMap (.ot)."),
    _map("--lethal", metavar="N", type=int, help="Smallest ROS occupancy (1 to 100) of an obstacle."),
    _map("--passable", metavar="LETTERS", help="Letters of free MovingAI terrain, such as '.GS'."),
    _map("--threshold", metavar="N", type=int, help="Smallest grey value of a free pixel of a picture."),
    _map("--spacing", metavar="H", type=Number("give a number in the unit of lengths, such as 0.05"),
         help="Width of a cell of a map without a resolution, or of a voxel of a point cloud."),
    _map("--origin", metavar="X,Y", type=NUMBERS, help="Lower corner of a map without a position."),
    _map("--crop", metavar="X0,Y0,X1,Y1", type=REGION,
         help="Keep only a part of the map: a box in world coordinates (X0,Y0,Z0,X1,Y1,Z1 in space), or known (the "
         "part without unknown borders)."),
    _map("--coarsen", metavar="N", type=int,
         help="Join N cells of the map along each axis into one, free only if all are free."),
    _map("--refine", metavar="N", type=int, help="Divide each cell of the map into N cells along each axis."),
    _map("--unit", metavar="NAME", help="Unit of lengths of a map without a unit."),
)  # fmt: skip
_DECK_OPTIONS: tuple[Decorator, ...] = (
    _deck("--read-as", type=Suggested("dialect", "auto", *DIALECTS), default="auto",
          help="Dialect of the deck, if its text does not show it; required for a deck from standard input (-), or "
          "from a file with another suffix than those of decks."),
    _deck("--root", metavar="FOLDER", type=click.Path(),
          help="Folder that may contain included files.  [default: the deck's folder]"),
)  # fmt: skip


@dataclass(frozen=True)
class CommandInput:
    """The input of a subcommand, with the shared options.

    `file`: name, or ``-`` for standard input; `map_options`: keywords of `read_scene` for maps; `changes`: new values
    of scene keys by key path, for `apply_overrides`; `threads`: largest number of threads of the solver; `dialect`:
    SPICE dialect of a deck, "auto" to recognise it from the text; `root`: folder that may contain included files, None
    for the deck's folder.
    """

    file: str
    map_options: Mapping[str, Any]
    changes: Mapping[str, Any]
    threads: int = 1
    dialect: str = "auto"
    root: str | None = None

    @property
    def name(self) -> str:
        """Name of the input in messages: that of the file, or ``standard input``."""
        return STANDARD_INPUT if self.file == "-" else self.file


def subcommand(name: str, *, examples: Sequence[str]) -> Decorator:
    """Return a decorator that makes a function a subcommand with the options of output (``--json``, ``-q``, ...).

    `name`: name of the subcommand; `examples`: command lines for its help text.
    """

    def decorate(function: Callable[..., Any]) -> click.Command:
        @functools.wraps(function)
        @click.pass_context
        def reporting(
            ctx: click.Context, /, as_json: bool, quiet: bool, verbose: bool, debug: bool, **values: Any
        ) -> Any:
            del debug  # used by the group, which prints errors
            ctx.obj = Verbosity(json=as_json, quiet=quiet, verbose=verbose)
            require_one_output(values.get("output"))
            return function(**values)

        command = click.command(name, cls=Subcommand, examples=examples, context_settings={"show_default": True})
        return command(_decorated(reporting, _REPORT_OPTIONS))

    return decorate


def with_source(metavar: str = "SCENE", *, required: bool = True) -> Decorator:
    """Return a decorator that passes the input and its options to a subcommand as the keyword ``source``.

    `metavar`: name of the input in help texts; if the name contains ``DECK``, options of decks are added; `required`:
    whether an input is necessary; if not, ``source`` is None without an input.
    """
    options = (*_SCENE_OPTIONS, *(_DECK_OPTIONS if "DECK" in metavar else ()))

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def bundled(file: str | None, **values: Any) -> Any:
            given: dict[str, dict[str, Any]] = {KEYS: {}, MAP: {}, DECK: {}}
            for option in click.get_current_context().command.params:
                name = option.name or ""
                if isinstance(option, SharedOption) and option.group in given:
                    given[option.group][name] = values.pop(name)
                elif isinstance(option.type, OutputPath) and file is not None:
                    _require_different_file(option.opts[0], values[name], file)
            if given[KEYS]["cells"] and not any(given[KEYS][key] for key in ("goal", "start")):
                _require_places(values)
            if file is None:
                names = [name for group in (KEYS, MAP, DECK) for name in given[group]]
                refuse_unused("no input is given, so options of inputs have no effect", given_options(*names))
            return function(source=None if file is None else _source(file, *given.values()), **values)

        return click.argument("file", metavar=metavar, type=SOURCE, required=required)(_decorated(bundled, options))

    return decorate


def _require_places(values: Mapping[str, Any]) -> None:
    """Raise InputError for ``--cells`` without effect, because no option gives a place.

    `values`: values of the subcommand's own options by name.
    """
    others = [name for name in ("between", "via") if name in values]
    if not any(values[name] for name in others):
        options = ", ".join(["--goal", "--start", *(f"--{name}" for name in others)])
        raise InputError(
            f"--cells applies to places on the command line, and none is given: leave it out, or add {options}"
        )


def _require_different_file(option: str, output: str | None, file: str) -> None:
    """Raise InputError, which names the `option`, if the file `output` is the input `file`; None: no output file."""
    if output is not None and Path(output).exists() and Path(file).exists() and Path(output).samefile(file):
        raise InputError(f"{option} {output}: this is the input; name another file")


def output_option(
    help_text: str, *, required: bool = False, of_folder: bool = False, may_be_folder: bool = False
) -> Decorator:
    """Return the decorator that adds the option ``-o`` to a subcommand.

    `help_text`: help of the option; `required`: whether it must be given; `of_folder`: whether it names a folder (True)
    or a file (False); `may_be_folder`: True if the input decides between file and folder, so that the subcommand has to
    check the name.
    """
    metavar = "DIR" if of_folder else "FILE"
    kind = OUTPUT_FOLDER if of_folder or may_be_folder else OUTPUT_FILE
    return _output("-o", "--output", metavar=metavar, type=kind, required=required, help=help_text)


def with_method(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a subcommand's function with the added options ``--method``, ``--ranks`` and ``--launcher``."""
    options = (
        click.option("--method", type=click.Choice(["auto", "direct", "multigrid", "petsc"]), default="auto",
                     help="Solution method; petsc is for grids that do not fit in memory otherwise."),
        click.option("--ranks", metavar="N", type=click.IntRange(1),
                     help="Number of processes of --method petsc.  [default: 2]"),
        click.option("--launcher", metavar="COMMAND",
                     help="Command that starts the processes of --method petsc and sets their number, in place of "
                     "mpiexec and --ranks: 'srun -n 64'. All computers must share the temporary folder (TMPDIR)."),
    )  # fmt: skip
    return _decorated(function, options)


def folder_of(output: str | None, source: CommandInput, end: str = "") -> Path:
    """Return the output folder: `output`, or by default ``out/NAME`` with the input's name followed by `end`.

    Raises InputError for ``-``, because standard output cannot hold several files.
    """
    if output == "-":
        raise InputError("-o -: the results are several files; name a folder")
    stem = "scene" if source.file == "-" or "://" in source.file else Path(source.file).stem
    name = re.sub(r"[^\w.-]+", "_", stem).strip(".") or "scene"
    return Path(output) if output else Path("out") / f"{name}{end}"


def dialect_option(default: str | None = "ngspice") -> Decorator:
    """Return the decorator that adds the option ``--dialect``, the SPICE dialect of the output deck.

    `default`: value if the option is not given; None if the subcommand then chooses the dialect.
    """
    return click.option(
        "--dialect", type=Suggested("dialect", *DIALECTS), default=default,
        help=f"SPICE dialect of the deck: {', '.join(DIALECTS)}.",
    )  # fmt: skip


def accepts_decks() -> bool:
    """Return whether the running subcommand accepts decks: whether it has the option ``--read-as``."""
    context = click.get_current_context(silent=True)
    return context is not None and "read_as" in {parameter.name for parameter in context.command.params}


def given_options(*names: str) -> list[str]:
    """Return those names of options, among `names`, that the user has given on the command line.

    Names have no leading dashes, and underscores in place of dashes, such as ``fixed_joints``.
    """
    source_of = click.get_current_context().get_parameter_source
    return [name for name in names if source_of(name) is ParameterSource.COMMANDLINE]


def refuse_unused(why: str, names: Sequence[str]) -> None:
    """Raise InputError that names options without effect, if there are any.

    `why`: reason, as a clause; `names`: names of parameters of the running subcommand, such as ``fixed_joints``.
    """
    if names:
        spelled = {option.name: max(option.opts, key=len) for option in click.get_current_context().command.params}
        options = ", ".join(spelled[name] for name in names)
        raise InputError(f"{why}: leave out {options}")


def _source(file: str, keys: dict[str, Any], of_map: Mapping[str, Any], of_deck: Mapping[str, Any]) -> CommandInput:
    """Return a subcommand's input.

    `file`: name of the input; `keys`, `of_map`, `of_deck`: values of the options for scene keys, maps and decks, by
    name of the option.  Raises InputError for an invalid ``--set`` and for a key that two options give differently.
    """
    plain = ("boundary", "drive", "edge", "leak", "lattice", "resistance")
    changes = {key: keys[key] for key in plain if keys[key] is not None}
    for key in ("goal", "start"):
        if keys[key]:
            changes |= _cells(key, keys[key]) if keys["cells"] else {key: list(keys[key])}
    if keys["k"]:
        changes["k"] = [k for several in keys["k"] for k in several]
    if keys["goal_tolerance"] is not None:
        changes["goal_tolerance"] = keys["goal_tolerance"]
    if keys["robot_radius"] is not None:
        changes["robot.radius"] = keys["robot_radius"]
    for setting in keys["settings"]:
        key, equals, value = (part.strip() for part in setting.partition("="))
        if not equals or not key:
            raise InputError(f"--set {setting!r}: expected KEY=VALUE, such as chip.supply=3.3")
        if changes.setdefault(key, value) != value:
            raise InputError(f"--set {setting}: {key} is also given as {_shown(changes[key])}; leave one of them out")
    if "boundary" in changes:  # blends and drive in the file belong to the boundary condition in the file
        changes.setdefault("k", [])
        if changes["boundary"] != "neumann":
            changes.setdefault("drive", None)
    options = {key.rstrip("_"): value for key, value in of_map.items() if value is not None}
    reading = {"dialect": of_deck.get("read_as", "auto"), "root": of_deck.get("root")}
    return CommandInput(file, options, changes, keys["threads"], **reading)


def _shown(value: Any) -> str:
    """Return the value of a scene key as text as on the command line; entries of a list are separated by commas."""
    return ",".join(map(_shown, value)) if isinstance(value, list | tuple) else f"{value}"


def _cells(key: str, places: Sequence[tuple[float, ...]]) -> dict[str, list[tuple[int, ...]]]:
    """Return the scene key for places that are given as cells: a dict from ``goal_cell`` or ``start_cell`` to indices.

    `key`: "goal" or "start"; `places`: cell indices as floats.
    """
    return {f"{key}_cell": [cell_indices(f"--{key}", place) for place in places]}


def cell_indices(option: str, place: Sequence[float]) -> tuple[int, ...]:
    """Return a place that is given as a cell as integers; raise InputError, which names the `option`, for fractions."""
    if not all(number.is_integer() for number in place):
        text = ",".join(f"{number:g}" for number in place)
        raise InputError(f"{option} {text}: with --cells, give whole numbers (cell indices), such as 3,4")
    return tuple(map(int, place))


def _decorated(function: Callable[..., Any], options: Sequence[Decorator]) -> Callable[..., Any]:
    for option in reversed(options):
        function = option(function)
    return function
