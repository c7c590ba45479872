"""The function `draw`, its registry of pictures by the type of the value, and pictures of scenes and circuits."""

from __future__ import annotations

import functools
import inspect
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from operator import attrgetter, methodcaller
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from resgrid._internal.validation import guarded, with_article
from resgrid.errors import InputError, ResgridError
from resgrid.plot.figures import NOTEBOOK_DPI, axes_or_new, render_figure

if TYPE_CHECKING:
    from resgrid.circuit.operating_point import OperatingPoint
    from resgrid.scene.scene import Scene

Picture = Callable[..., Axes | Figure]
"""Function that draws a value: its arguments are the value, optionally ``ax``, and options; its result is axes or a
figure."""

PictureT = TypeVar("PictureT", bound=Picture)

PICTURES = {
    "resgrid.chip.adc_resolution:ADCResolution": "chip_maps:draw_adc_resolution",
    "resgrid.chip.fault_analysis:FaultAnalysis": "chip_maps:draw_faults",
    "resgrid.chip.noise:Noise": "chip_maps:draw_noise",
    "resgrid.chip.power:Power": "chip_maps:draw_power",
    "resgrid.chip.sensitivity:Sensitivity": "chip_maps:draw_sensitivity",
    "resgrid.chip.settling:Settling": "chip_curves:draw_settled",
    "resgrid.chip.sweeps:Sweep": "chip_curves:draw_sweep",
    "resgrid.chip.yield_loss:YieldLoss": "yield_loss:draw_yield_loss",
    "resgrid.chip.yields:Yield": "chip_maps:draw_yield",
    "resgrid.circuit.operating_point:OperatingPoint": "pictures:draw_operating_point",
    "resgrid.circuit.transients.memristive:MemristiveTransient": "memristors:draw_memristive",
    "resgrid.control.run_log:Run": "control:draw_run",
    "resgrid.control.wavefronts:Wavefront": "control:draw_wavefront",
    "resgrid.core.netlist:Netlist": "netlist_graphs:draw_circuit",
    "resgrid.core.space:ConfigurationSpace": "panels:draw_space",
    "resgrid.hardware.board:Board": "boards:draw_board",
    "resgrid.hardware.layout:Layout": "layouts:draw_layout",
    "resgrid.planning.blocking_obstacles:SceneSeparation": "paths:draw_separation",
    "resgrid.planning.blocking_obstacles:Separation": "paths:draw_separation",
    "resgrid.planning.fields:Field": "fields:draw_field",
    "resgrid.planning.lattice_fields:LatticeField": "lattices:draw_lattice_field",
    "resgrid.planning.node_paths:NodePath": "path_pages:draw_path",
    "resgrid.planning.clearance_curves:ClearanceCurve": "paths:draw_clearance_curve",
    "resgrid.planning.streamline:Polyline": "path_pages:draw_line",
    "resgrid.planning.short_path:ShortPath": "path_pages:draw_line",
    "resgrid.planning.streamline:Streamline": "path_pages:draw_path",
    "resgrid.planning.time_parameterization:Trajectory": "trajectories:draw_trajectory",
    "resgrid.scene.scene:Scene": "pictures:draw_scene_or_cells",
}
"""Function that draws each type.  A key is "module:class" of the value; the entry is "module:function" in
`resgrid.plot`, imported when the first such value is drawn."""

PICTURES_OF_SEVERAL = {
    "resgrid.chip.adc_resolution:ADCResolution": "chip_curves:draw_adc_resolutions",
    "resgrid.control.run_log:Run": "control:draw_runs",
    "resgrid.planning.node_paths:NodePath": "path_pages:draw_streamlines",
    "resgrid.planning.streamline:Streamline": "path_pages:draw_streamlines",
}
"""Function that draws a sequence of values of a type, or a mapping of names to such values; the form is that of
`PICTURES`."""

SHOWN_PARTS: dict[str, Callable[[Any], object]] = {
    "resgrid.chip.study_analyses:Study": attrgetter("op"),
    "resgrid.planning.planner:Planner": attrgetter("field"),
    "resgrid.spice.circuit:Circuit": methodcaller("netlist"),
}
"""For a type without a picture of its own: function from a value of the type to another value, which is drawn instead.

The key is the module and the name of the class, separated by a colon.
"""


@functools.singledispatch
def _one(value: object) -> Axes | Figure:
    """Draw one value by the function registered for the value's type, and return axes or a figure.

    For a type without a registered function, this function raises NotImplementedError.
    """
    raise NotImplementedError


@functools.singledispatch
def _several(value: object) -> Axes | Figure:
    """Draw a sequence or a mapping of values, and return axes or a figure: fallback that raises NotImplementedError.

    `draw` selects the drawing function by the type of the first entry, not of the container, from those that are
    registered here.  The drawing function gets the whole container.
    """
    raise NotImplementedError


def register(kind: type, *, several: bool = False) -> Callable[[PictureT], PictureT]:
    """Return a decorator that makes a function the picture of a type and its subclasses.

    Parameters
    ----------
    kind : type
        Type of the values.
    several : bool
        Whether the function draws a sequence of such values, or a mapping of names to values.

    Returns
    -------
    callable
        Decorator of a function that takes the value, perhaps ``ax``, and options, and returns axes or a figure.  An
        ``ax`` without a default value is never None: `draw` makes the axes of a new figure.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> @rg.draw.register(complex)
    ... def draw_point(value, ax):
    ...     ax.plot(value.real, value.imag, "o")
    ...     return ax
    >>> len(rg.draw(1 + 2j, Figure().add_subplot()).lines)
    1
    """
    return cast("Callable[[PictureT], PictureT]", (_several if several else _one).register(kind))


class _Draw(Protocol):
    """Type of the function `draw`, which has the decorator `register` as an attribute."""

    register: Callable[..., Callable[[PictureT], PictureT]]

    def __call__(self, value: object, ax: Axes | None = None, **options: Any) -> Any: ...


def _with_register(function: Callable[..., Any]) -> _Draw:
    """Return a function to which `register` was attached as an attribute."""
    function.register = register  # type: ignore[attr-defined]
    return cast("_Draw", function)


@_with_register
def draw(value: object, ax: Axes | None = None, **options: Any) -> Any:
    """Draw a value: scene, space, field, path, circuit, run, or result of a chip analysis.

    ==================  ===========================================  =================================================
    value               picture                                      options
    ==================  ===========================================  =================================================
    scene               workspace: obstacles, goals, starts; of an
                        arm in space also the arm; of points with
                        other than two axes the cells
    space               cells and conductivity                       ``virtual``, ``unknown`` (masks of obstacle cells
                                                                     with colours of their own); of three or four axes
                                                                     ``axis``, ``indices``, here and below
    field               potential of one to four axes, or currents   ``quantity`` ("potential", "currents"), ``scale``
                                                                     ("auto", "linear", "log": decades of the drop),
                                                                     ``contours``, ``axis``, ``indices``
    field of a lattice  potential at its sites, and of small         ``scale``, ``axis``, ``indices``
                        lattices their resistors
    path, paths         streamlines on the cells, or on a given ax;  ``axis``, ``indices``; of several ``k`` (of each),
                        of a point or ball in space the surface of   ``unknown`` (mask of obstacle cells)
                        the obstacles, and slices at the path
    trajectory          speed and position over time                 ``quantity`` ("page", "speed", "position")
    netlist             circuit diagram                              ``op`` (voltages to write)
    circuit of a deck   circuit diagram of its netlist
    operating point     circuit with voltages, or the potential of
                        a grid with more than 10 cells a side
    planner, study      its field, its operating point
    separation          obstacles between a start and the goals      ``virtual``, ``axis``, ``indices``
    clearance curve     mean and spread against k                    ``unit``, ``cell`` (width, for an error bar)
    run                 workspace and configuration space            ``title``, ``caption``
    runs                the same motion at several k                 ``title``, ``caption``
    settling            settling time of each cell                   ``quantity`` ("map", "curve")
    noise               rms noise, resistance to the rails           ``quantity`` ("total", "limit", "resistance")
    power               heat, droop of the rails                     ``quantity`` ("heat", "droop")
    adc resolution      converter bits required by starts            ``starts``, ``most``
    {name: resolution}  maps, histogram, fraction served             ``quantity`` ("page", "served", "histogram"),
                                                                     ``bits``, ``title``
    sensitivity         resistors that change a step                 ``drift``
    faults              resistors that cost starts                   ``fault`` ("open", "short")
    yield               fraction of chips that serve each start
    yield loss          change of the yield without each effect
    sweep               yield over two values                        ``share``
    board               bridges or expected voltages, or a side      ``side`` ("plan", "front", "back")
    wavefront           change of the potential over time            ``shown`` (indices of its times)
    layout              the whole block, and one tile of it
    memristors          resistances of the links of a grid, or the   ``quantity`` ("auto", "map", "states"), ``at``
                        states over time                             (index of its times)
    ==================  ===========================================  =================================================

    The decorator ``@rg.draw.register(MyType)`` adds the picture of another type: a function of a value, ``ax`` and
    options.

    Parameters
    ----------
    value : object
        One of the above.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default those of a new figure.  Pictures with several panels make a figure of their own.
    **options
        Options of the picture, see the table.

    Returns
    -------
    matplotlib.axes.Axes or matplotlib.figure.Figure
        The axes, or the figure of a picture with several panels; `save_figure` accepts both.

    Raises
    ------
    InputError
        If the value has no picture, an option does not belong to the picture, or the value cannot be drawn.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((0.5, 6.5))
    >>> ax = rg.draw(path, rg.draw(path.field))
    >>> rg.plot.save_figure(ax, "path.png").name
    'path.png'
    """
    value = _shown_part(value)
    picture = _picture_of(value)
    parameters = inspect.signature(picture).parameters
    accepted = list(parameters)[1:]
    unknown = [name for name in options if name not in accepted]
    if unknown:
        allowed = ", ".join(name for name in accepted if name != "ax") or "no option"
        raise InputError(f"{unknown[0]} is not an option of a picture of {_named(value)}; it takes {allowed}")
    if ax is not None and "ax" not in accepted:
        raise InputError(f"a picture of {_named(value)} has several panels and cannot use one ax; omit ax")
    if "ax" in accepted:
        needs_axes = parameters["ax"].default is inspect.Parameter.empty
        options["ax"] = axes_or_new(ax) if needs_axes else ax
    return guarded("draw", picture)(value, **options)


def image_html(value: object) -> str | None:
    """Return the picture of a value as an HTML ``<img>`` element with a PNG image; None if it cannot be drawn."""
    try:
        content = render_figure(draw(value), "png", dpi=NOTEBOOK_DPI)
    except ResgridError:
        return None
    return f'<img src="data:image/png;base64,{b64encode(content).decode()}" alt="picture of {_named(value)}">'


def draw_operating_point(op: OperatingPoint, ax: Axes | None = None) -> Axes | Figure:
    """Draw a circuit diagram with its voltages, or the potential of a large grid or of a lattice.

    A grid is large if it has more than two axes, or more than 10 cells along an axis.  Returns the axes, or the figure
    of a space with more than two axes.  `ax`: axes to draw on, by default those of a new figure.
    """
    from resgrid.planning.fields import field
    from resgrid.planning.lattice_fields import lattice_field
    from resgrid.plot.circuits import MOST_CELLS_A_SIDE
    from resgrid.plot.fields import draw_field
    from resgrid.plot.lattices import draw_lattice_field
    from resgrid.plot.netlist_graphs import draw_circuit

    cells = op.netlist.cell_map
    if op.netlist.lattice_map is not None:
        return draw_lattice_field(lattice_field(op), ax)
    if cells is None or (max(cells.space.shape) <= MOST_CELLS_A_SIDE and cells.space.ndim <= 2):
        return draw_circuit(op.netlist, ax, op=op)
    return draw_field(field(op), ax)


def draw_scene_or_cells(scene: Scene, ax: Axes | None = None) -> Axes | Figure:
    """Draw the workspace of a scene, or the cells of its space for a point or a ball with one, three or four axes.

    Returns the axes, or the figure of a space with more than two axes.  `ax`: axes to draw on, by default those of a
    new figure.
    """
    from resgrid.plot.panels import draw_space
    from resgrid.plot.workspace import draw_scene
    from resgrid.scene.sampling import build_space

    if scene.robot.moves_in_workspace and scene.ndim != 2:
        return draw_space(build_space(scene, require_goal=False), ax)
    return draw_scene(scene, ax)


def _picture_of(value: object) -> Picture:
    """Return the function that draws a value (arguments: value, optionally ``ax``, options; result: axes or a figure).

    `value`: a value, or a sequence or mapping of values of one type; raise InputError if there is no such function.
    """
    registry, table, one = _one, PICTURES, value
    if isinstance(value, Mapping | Sequence) and not isinstance(value, str | bytes) and len(value):
        registry, table = _several, PICTURES_OF_SEVERAL
        one = next(iter(value.values() if isinstance(value, Mapping) else value))
    for kind in type(one).__mro__:
        entry = table.get(_key(kind))
        if entry is not None and kind not in registry.registry:
            module, name = entry.split(":")
            registry.register(kind, getattr(import_module(f"resgrid.plot.{module}"), name))
    picture = registry.dispatch(type(one))
    if picture is registry.registry[object]:
        known = {key.partition(":")[2] for key in PICTURES} | {kind.__name__ for kind in _one.registry} - {"object"}
        raise InputError(f"{_named(value)} has no picture; there are pictures of {', '.join(sorted(known))}")
    return picture


def _shown_part(value: object) -> object:
    """Return the object that is drawn: the value, or the result of its type's function in `SHOWN_PARTS`."""
    for kind in type(value).__mro__:
        if _key(kind) in SHOWN_PARTS and kind not in _one.registry:
            return SHOWN_PARTS[_key(kind)](value)
    return value


def _key(kind: type) -> str:
    """Return the key of a type in `PICTURES`: module and class name, separated by a colon."""
    return f"{kind.__module__}:{kind.__qualname__}"


def _named(value: object) -> str:
    """Return the name of a value's type with its article, for messages ("a Field")."""
    return with_article(type(value).__name__)
