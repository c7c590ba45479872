"""One function for all pictures: a table says which picture a value has."""

from __future__ import annotations

import inspect
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter, methodcaller
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from resgrid._internal.validation import guarded, with_article
from resgrid.chip.adc_resolution import ADCResolution
from resgrid.chip.fault_analysis import FaultAnalysis
from resgrid.chip.noise import Noise
from resgrid.chip.power import Power
from resgrid.chip.sensitivity import Sensitivity
from resgrid.chip.settling import Settling
from resgrid.chip.study_analyses import Study
from resgrid.chip.sweeps import Sweep
from resgrid.chip.yield_loss import YieldLoss
from resgrid.chip.yields import Yield
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.control.run_log import Run
from resgrid.control.simulation import Wavefront
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError, ResgridError
from resgrid.planning.blocking_obstacles import SceneSeparation, Separation
from resgrid.planning.fields import Field, field
from resgrid.planning.planner import ClearanceCurve, Planner
from resgrid.planning.streamline import Polyline, ShortPath, Streamline
from resgrid.plot.chip_curves import draw_adc_resolutions, draw_settled, draw_sweep
from resgrid.plot.chip_maps import (
    draw_adc_resolution,
    draw_faults,
    draw_noise,
    draw_power,
    draw_sensitivity,
    draw_yield,
)  # fmt: skip
from resgrid.plot.circuits import MOST_CELLS_A_SIDE
from resgrid.plot.control import draw_run, draw_runs, draw_wavefront
from resgrid.plot.fields import draw_field
from resgrid.plot.figures import NOTEBOOK_DPI, render_figure
from resgrid.plot.netlist_graphs import draw_circuit
from resgrid.plot.panels import draw_space
from resgrid.plot.paths import draw_clearance_curve, draw_line, draw_path, draw_separation, draw_streamlines
from resgrid.plot.workspace import draw_scene
from resgrid.plot.yield_loss import draw_yield_loss
from resgrid.scene.sampling import sample
from resgrid.scene.scene import Scene
from resgrid.spice.circuit import Circuit

Picture = Callable[..., Axes | Figure]


def _draw_operating_point(op: OperatingPoint, ax: Axes | None = None) -> Axes | Figure:
    """A circuit with its voltages, or, of a grid too large for that, the potential."""
    cells = op.netlist.cell_map
    if cells is None or (max(cells.space.shape) <= MOST_CELLS_A_SIDE and cells.space.ndim <= 2):
        return draw_circuit(op.netlist, ax, op=op)
    return draw_field(field(op), ax)


def _draw_scene(scene: Scene, ax: Axes | None = None) -> Axes | Figure:
    """A workspace in the plane; of a robot that moves in one of other axes, its cells."""
    if scene.robot.moves_in_workspace and scene.ndim != 2:
        return draw_space(sample(scene, require_goal=False), ax)
    return draw_scene(scene, ax)


PICTURES: dict[type, Picture] = {
    ClearanceCurve: draw_clearance_curve,
    ConfigurationSpace: draw_space,
    FaultAnalysis: draw_faults,
    Sweep: draw_sweep,
    Field: draw_field,
    Netlist: draw_circuit,
    Noise: draw_noise,
    OperatingPoint: _draw_operating_point,
    Polyline: draw_line,
    Power: draw_power,
    ADCResolution: draw_adc_resolution,
    Run: draw_run,
    Scene: _draw_scene,
    Sensitivity: draw_sensitivity,
    Separation: draw_separation,
    SceneSeparation: draw_separation,
    Settling: draw_settled,
    ShortPath: draw_line,
    Streamline: draw_path,
    Wavefront: draw_wavefront,
    Yield: draw_yield,
    YieldLoss: draw_yield_loss,
}
"""The picture of a value, by its type: a function of the value, perhaps an ax, and options."""

PICTURES_OF_MANY: dict[type, Picture] = {
    ADCResolution: draw_adc_resolutions,
    Run: draw_runs,
    Streamline: draw_streamlines,
}
"""The picture of several values together: of a sequence, of ADC resolutions a mapping from their names."""


SEEN_AS: dict[type, Callable[[Any], object]] = {
    Circuit: methodcaller("netlist"),
    Planner: attrgetter("field"),
    Study: attrgetter("op"),
}
"""What is drawn of a value that has no picture of its own."""


def draw(value: object, ax: Axes | None = None, **options: Any) -> Any:
    """Draw a value: a scene, a space, a field, paths, a circuit, a run, or what a study of a chip found.

    ==================  ===========================================  =================================================
    value               picture                                      options
    ==================  ===========================================  =================================================
    scene               workspace: obstacles, goals, starts; of
                        other than two axes its cells
    space               cells and conductivity                       ``virtual``, ``unknown`` (masks of obstacle cells
                                                                     with colours of their own); of three axes
                                                                     ``axis``, ``indices``, here and below
    field               potential of one to three axes, or currents  ``quantity`` ("potential", "currents"), ``scale``
                                                                     ("auto", "linear", "log": decades of the drop),
                                                                     ``contours``, ``axis``, ``indices``
    path, paths         streamlines, over what the ax shows          ``axis``, ``indices``; of several ``k`` (of each)
    netlist             circuit diagram                              ``op`` (voltages to write)
    circuit of a deck   as its netlist
    operating point     circuit with voltages, or the potential of
                        a grid with more than 10 cells a side
    planner, study      its field, its operating point
    separation          what keeps a start from the goals            ``virtual``, ``axis``, ``indices``
    clearance curve     mean and spread against k                    ``unit``, ``cell`` (width, for an error bar)
    run                 workspace and configuration space            ``title``, ``caption``
    runs                the same motion at several k                 ``title``, ``caption``
    settling            when each cell has settled                   ``quantity`` ("map", "curve")
    noise               rms noise, resistance to the rails           ``quantity`` ("total", "limit", "resistance")
    power               heat, droop of the rails                     ``quantity`` ("heat", "droop")
    ADC resolution      converter bits that starts need              ``starts``, ``most``
    {name: ADC          maps, histogram, fraction of starts served   ``quantity`` ("page", "served", "histogram"),
    resolution}                                                      ``bits``, ``title``
    sensitivity         resistors that change a step                 ``drift``
    fault analysis      resistors that cost starts                   ``fault`` ("open", "short")
    yield               share of chips that serve each start
    yield loss          change of the yield without each effect
    sweep               yield over two values                        ``share``
    wavefront           how a new obstacle spreads                   ``shown`` (numbers of its times)
    ==================  ===========================================  =================================================

    Parameters
    ----------
    value : object
        One of the above.
    ax : matplotlib.axes.Axes, optional
        Where to draw; made when None.  Pictures of several panels make a figure of their own.
    **options
        As the table says.

    Returns
    -------
    matplotlib.axes.Axes or matplotlib.figure.Figure
        The axes, or the figure where there are several; `save_figure` takes both.

    Raises
    ------
    InputError
        If the value has no picture, an option does not belong to it, or the value cannot be drawn.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((0.5, 6.5))
    >>> ax = rg.draw(path, rg.draw(path.field))
    >>> rg.save_figure(ax, "path.png").name
    'path.png'
    """
    value = next((part(value) for kind, part in SEEN_AS.items() if isinstance(value, kind)), value)
    picture = _picture_of(value)
    takes = list(inspect.signature(picture).parameters)[1:]
    unknown = [name for name in options if name not in takes]
    if unknown:
        allowed = ", ".join(name for name in takes if name != "ax") or "no option"
        raise InputError(f"{unknown[0]} is no option of a picture of {_named(value)}; it takes {allowed}")
    if ax is not None and "ax" not in takes:
        raise InputError(f"a picture of {_named(value)} has several panels, and is not drawn into one ax: leave ax out")
    return guarded("draw", picture)(value, **options, **({"ax": ax} if "ax" in takes else {}))


def image_html(value: object) -> str | None:
    """The picture of a value as an image in HTML; None where it cannot be drawn."""
    try:
        content = render_figure(draw(value), "png", dpi=NOTEBOOK_DPI)
    except ResgridError:
        return None
    return f'<img src="data:image/png;base64,{b64encode(content).decode()}" alt="picture of {_named(value)}">'


def _picture_of(value: object) -> Picture:
    table, one = PICTURES, value
    if isinstance(value, Mapping | Sequence) and not isinstance(value, str | bytes) and len(value):
        table, one = PICTURES_OF_MANY, next(iter(value.values() if isinstance(value, Mapping) else value))
    for kind, picture in table.items():
        if isinstance(one, kind):
            return picture
    known = ", ".join(kind.__name__ for kind in PICTURES)
    raise InputError(f"{_named(value)} has no picture; there are pictures of {known}")


def _named(value: object) -> str:
    return with_article(type(value).__name__)
