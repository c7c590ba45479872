"""Which pictures a scene has, and how each is drawn from its plan."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resgrid.cli.paths import Plan
from resgrid.cli.scenes import Job
from resgrid.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes  # noqa: TID251
    from matplotlib.figure import Figure  # noqa: TID251

    from resgrid.planning.fields import Field

PAGE_AXES = 3
"""Most axes of a space that is drawn."""

CIRCUIT_CELLS = 8
"""Longest side of a grid that is drawn as a circuit."""


def draw_all(folder: Path, job: Job, plan: Plan) -> dict[str, str]:
    """Draw every picture that a scene of this kind has."""
    from resgrid.plot import save_figure

    files = {}
    for name, (what, draw) in _album(job, plan).items():
        save_figure(draw(), folder / f"{name}.png")
        files[f"{name}.png"] = what
    return files


def draw_picture(what: str, job: Job, plan: Plan) -> Axes | Figure:
    """Draw one picture."""
    if not plan.fields and what != "space":
        raise InputError("no start can be driven, so there is no field to draw: use --drive uniform, or move the start")
    return PICTURES[what](job, plan, plan.fields[0] if plan.fields else None)


def _album(job: Job, plan: Plan) -> dict[str, tuple[str, Callable[[], Axes | Figure]]]:
    """Pictures of a plan: file name, what it shows, and how it is drawn."""
    album: dict[str, tuple[str, Callable[[], Axes | Figure]]] = {}
    several = len(plan.fields) > 1
    for number, field in enumerate(plan.fields if job.space.ndim <= PAGE_AXES else ()):
        mark = f"chip_{number}" if job.scene.drive == "start" else f"k_{field.k:g}"
        what = "potential, currents and paths" + (f", {mark.replace('_', ' ')}" if several else "")
        album[f"page_{mark}" if several else "page"] = what, partial(_page, job, plan, field)
    if job.space.ndim == 2 and (several or not plan.fields):
        album["paths"] = "map and all paths", partial(_paths, job, plan)
    if _has_body(job) and any(route.reached for route in plan.routes):
        album["robot"] = "the robot in its workspace along its first path", partial(_robot, job, plan)
    if job.space.ndim <= 2 and max(job.space.shape) <= CIRCUIT_CELLS and len(plan.operating_points) == 1:
        album["circuit"] = "the chip as a circuit, with its voltages", partial(_circuit, job, plan)
    return album


def _page(job: Job, plan: Plan, field: Field | None) -> Figure:
    from resgrid.plot import draw_page

    assert field is not None
    own = [route for route in plan.routes if not route.field.is_flowing or route.field is field]
    return draw_page(field, [route.streamline for route in own], title=_title(job, plan, field))


def _title(job: Job, plan: Plan, field: Field) -> str:
    pure = {0.0: " (Neumann)", 1.0: " (wall)" if job.scene.boundary == "wall" else " (Dirichlet)"}.get(field.k, "")
    mark = f"k = {field.k:g}{pure}" if len(plan.fields) > 1 and job.scene.drive != "start" else ""
    return ", ".join(part for part in (job.scene.title, mark) if part)


def _space(job: Job, _plan: Plan, _field: Field | None = None) -> Any:
    from resgrid.plot import draw

    return draw(job.space)


def _potential(_job: Job, _plan: Plan, field: Field | None) -> Any:
    from resgrid.plot import draw

    return draw(field)


def _currents(_job: Job, _plan: Plan, field: Field | None) -> Any:
    from resgrid.plot import draw

    return draw(field, quantity="currents")


def _paths(job: Job, plan: Plan, _field: Field | None = None) -> Any:
    from resgrid.plot import draw

    axes = draw(job.space)
    lines, shares = [route.streamline for route in plan.routes], [route.field.k for route in plan.routes]
    return draw(lines, axes, space=job.space, k=shares)


def _has_body(job: Job) -> bool:
    """Whether the robot's workspace is another plane than its configuration space."""
    return not job.scene.robot.moves_in_workspace


def _robot(job: Job, plan: Plan, _field: Field | None = None) -> Figure:
    from resgrid.plot import add_title, draw_pair, draw_robot, figure_of

    if not _has_body(job):
        raise InputError(
            "--what robot: this robot is a point or a disc, whose picture is 'paths'; it draws arms and polygons"
        )
    route = next((route for route in plan.routes if route.reached), None)
    if route is None:
        raise InputError("--what robot: no path reaches a goal, so there is nothing to drive along")
    scene = job.scene
    if job.space.ndim == 2:
        return draw_pair(route.streamline, scene, job.space, title=scene.title)
    figure = figure_of(draw_robot(route.streamline, scene))
    add_title(figure, scene.title)
    return figure


def _circuit(_job: Job, plan: Plan, _field: Field | None = None) -> Any:
    from resgrid.plot import draw

    return draw(next(iter(plan.operating_points.values())))


def _slices(_job: Job, plan: Plan, field: Field | None) -> Figure:
    from resgrid.plot import draw_slices

    assert field is not None
    return draw_slices(field, paths=[route.streamline for route in plan.routes if route.field.is_flowing])


PICTURES: dict[str, Callable[..., Axes | Figure]] = {
    "page": _page,
    "space": _space,
    "potential": _potential,
    "currents": _currents,
    "paths": _paths,
    "circuit": _circuit,
    "slices": _slices,
    "robot": _robot,
}
