"""``resgrid plot``: draw one picture of a scene, or, for ``resgrid run``, all pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid.cli.options import CommandInput, output_option, subcommand, with_source
from resgrid.cli.paths import Plan, plan_routes
from resgrid.cli.scenes import Job, open_job, report_ignored
from resgrid.cli.terminal import finish, stage
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.planning.any_field import AnyField

PICTURES = ("page", "space", "potential", "currents", "paths", "circuit", "slices", "robot")
PAGE_AXES = 4
"""Largest number of axes of a space for which ``resgrid run`` draws pages: potential, currents and paths together."""

CIRCUIT_CELLS = 8
"""Largest number of cells along an axis for which ``resgrid run`` draws the circuit."""


@subcommand(
    "plot",
    examples=("resgrid plot map.yaml --what space -o cells.png", "resgrid plot rooms.toml --k 0 -o page.pdf"),
)
@with_source()
@output_option("The picture: FILE.png, .pdf or .svg; - prints a PNG.", required=True)
@click.option("--what", default="page", type=click.Choice(PICTURES), help="Which picture.")
def command(source: CommandInput, output: str, what: str) -> int:
    """Draw one picture of SCENE.

    A page shows potential, currents and paths together; a space of three or four axes is drawn in slices. In
    space, '--what paths' draws the surface of the obstacles and slices at the paths. Of several blends in the scene,
    the first one is drawn; choose a blend with --k. '--what space' draws only the cells, for which a map needs no goal.
    """
    from resgrid.io.tables import emit
    from resgrid.plot.figures import picture_format, render_figure

    suffix = "png" if output == "-" else picture_format(output)
    job = open_job(source, require_goal=what != "space")
    if what == "currents" and job.space.ndim != 2:
        raise InputError(f"--what {what}: it needs two axes, and this space has {job.space.ndim}; 'page' shows up to 4")
    if what == "slices" and job.space.ndim < 3:
        raise InputError(f"--what slices: a space of {job.space.ndim} axes is not cut into slices; draw 'potential'")
    if what == "currents":
        from resgrid.core.lattice import require_square

        require_square(job.scene.lattice, "--what currents")
    ignored = report_ignored(job, "grid", k=() if what == "space" else job.scene.k[1:])
    plan = Plan({}, [], []) if what == "space" else plan_routes(job)
    if not plan.fields and what != "space":
        raise InputError("no start can be driven, so there is no field to draw: use --drive uniform, or add a start")
    with stage("draw the picture"):
        picture = _draw(what, job, plan, plan.fields[0] if plan.fields else None)
        emit(output, render_figure(picture, suffix))
    finish({"file": output, "what": what, **ignored}, written=output)
    return 0


def draw_all(folder: Path, job: Job, plan: Plan) -> dict[str, str]:
    """Draw all pictures of a scene into a folder as PNG files; return the captions of the pictures by file name.

    `job`: scene and space; `plan`: its solved circuits, fields and paths.
    """
    files = {}
    for name, caption, what, field in _album(job, plan):
        rg.plot.save_figure(_draw(what, job, plan, field), folder / f"{name}.png")
        files[f"{name}.png"] = caption
    return files


def _album(job: Job, plan: Plan) -> Iterator[tuple[str, str, str, AnyField | None]]:
    """Yield file name, caption, kind (a name in `PICTURES`) and field of each picture that ``resgrid run`` draws.

    The file name has no suffix.  The field is None for a picture of all paths, the robot, the cells or the circuit.
    `plan`: solved circuits, fields and paths.
    """
    several = len(plan.fields) > 1
    for number, field in enumerate(plan.fields if job.space.ndim <= PAGE_AXES else ()):
        mark = f"chip_{number}" if job.scene.drive == "start" else f"k_{field.k:g}"
        name, end = (f"page_{mark}", f", {mark.replace('_', ' ')}") if several else ("page", "")
        yield name, f"potential, currents and paths{end}", "page", field
    if job.space.ndim == 3 and plan.streamlines and job.scene.robot.moves_in_workspace:
        yield "paths", "obstacles in space and all paths, with horizontal slices", "paths", None
    if job.space.ndim == 2 and (several or not plan.fields):
        yield "paths", "map and all paths", "paths", None
    if not job.scene.robot.moves_in_workspace and any(route.reached for route in plan.routes):
        yield "robot", "the robot in its workspace along its first path", "robot", None
    if job.scene.robot.workspace_ndim == 3 and job.space.ndim > 1:
        yield "cells", "cells of the space by verdict", "space", None
    if job.space.ndim <= 2 and max(job.space.shape) <= CIRCUIT_CELLS and len(plan.operating_points) == 1:
        yield "circuit", "the chip as a circuit, with its voltages", "circuit", None


def _draw(what: str, job: Job, plan: Plan, field: AnyField | None) -> Any:
    """Draw one picture, and return its matplotlib axes or figure.

    `what`: kind of the picture, a name in `PICTURES`; `plan`: solved circuits, fields and paths; `field`: field in the
    picture, None for a picture of all paths, of the robot, of the cells or of the circuit.  In a space of two axes,
    unknown cells of a map have a colour of their own.
    """
    picture = _drawn(what, job, plan, field)
    if what in ("page", "potential", "currents", "paths"):
        from resgrid.plot.panels import paint_unknown
        from resgrid.scene.world_coordinates import unknown_cells

        paint_unknown(picture, job.space, unknown_cells(job.scene.map, job.space.axes))
    return picture


def _circuit_of(plan: Plan, field: AnyField | None) -> rg.OperatingPoint:
    """Return the solved circuit of `field`, the first circuit if `field` is None; raise InputError for a blend.

    A blend (0 < k < 1) has two circuits.  `plan`: solved circuits by name.
    """
    circuits = plan.operating_points
    if field is not None and 0 < field.k < 1:
        raise InputError(
            f"--what circuit: k = {field.k:g} blends the fields of two circuits; give --boundary dirichlet or "
            "--boundary neumann in place of --k"
        )
    is_open = field is not None and field.k == 0
    return next(
        (op for name, op in circuits.items() if name.startswith("neumann") == is_open), next(iter(circuits.values()))
    )


def _drawn(what: str, job: Job, plan: Plan, field: AnyField | None) -> Any:
    lines = plan.streamlines
    match what:
        case "robot":
            return _draw_robot(job, plan)
        case "circuit":
            if not plan.operating_points:
                raise InputError("--what circuit: nothing drives this scene, so there is no circuit; draw 'page'")
            return rg.draw(_circuit_of(plan, field))
        case "potential" | "currents":
            assert field is not None
            options: dict[str, Any] = {} if isinstance(field, rg.planning.LatticeField) else {"quantity": what}
            return _titled(rg.draw(field, **options), _title(job, plan, field))
        case "paths" if lines:
            from resgrid.scene.world_coordinates import unknown_cells

            unknown = unknown_cells(job.scene.map, job.space.axes) if job.space.ndim == 3 else None
            picture = rg.draw(lines, k=[line.field.k for line in lines], unknown=unknown)
            return _titled(picture, job.scene.title)
        case "space" | "paths":
            from resgrid.scene.world_coordinates import unknown_cells

            picture = rg.draw(job.space, unknown=unknown_cells(job.scene.map, job.space.axes))
            return _titled(picture, job.scene.title)
    assert field is not None
    own = [line for line in lines if not line.field.is_flowing or line.field is field]
    return rg.plot.draw_summary(field, own, title=_title(job, plan, field))


def _title(job: Job, plan: Plan, field: AnyField) -> str:
    pure = {0.0: " (Neumann)", 1.0: " (wall)" if job.scene.boundary == "wall" else " (Dirichlet)"}.get(field.k, "")
    mark = f"k = {field.k:g}{pure}" if len(plan.fields) > 1 and job.scene.drive != "start" else ""
    return ", ".join(part for part in (job.scene.title, mark) if part)


def _draw_robot(job: Job, plan: Plan) -> Any:
    """Return the picture of the robot along its first path that reaches a goal, in the workspace, as a figure.

    The figure of a space with two axes also shows the path in configuration space.  Without such a path, an arm in
    space is drawn at its start, and InputError is raised for other robots, and for points and discs.
    """
    if job.scene.robot.moves_in_workspace:
        raise InputError(
            "--what robot: this robot is a point or a disc, whose picture is 'paths'; it draws arms and polygons"
        )
    path = next((path for path in plan.streamlines if path.outcome is rg.Outcome.REACHED), None)
    if path is None and job.scene.robot.workspace_ndim == 3:
        return _titled(rg.draw(job.scene), job.scene.title)
    if path is None:
        raise InputError("--what robot: no path reaches a goal, so the robot has no path; draw 'page' instead")
    if job.space.ndim == 2:
        return rg.plot.draw_workspace_and_space(path, job.scene, title=job.scene.title)
    return _titled(rg.plot.draw_robot(path, job.scene), job.scene.title)


def _titled(picture: Any, title: str) -> Any:
    """Write a title above a picture (matplotlib axes or figure), and return its figure."""
    from resgrid.plot.figures import add_title, figure_of

    figure = figure_of(picture)
    add_title(figure, title)
    return figure
