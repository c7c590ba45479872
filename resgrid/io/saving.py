"""`save`: writes any result to a file, in a format that follows from its type and the file's suffix."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

from resgrid._internal.validation import check_call, with_article
from resgrid.circuit.effective_resistance import EffectiveResistance
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.control.run_log import Run
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.hardware.board import Board
from resgrid.hardware.layout import Layout
from resgrid.hardware.layout_files import write_layout
from resgrid.io.boards import save_board
from resgrid.io.leg_paths import write_leg_path
from resgrid.io.networks import write_network
from resgrid.io.paths import write_path
from resgrid.io.resistances import write_resistances
from resgrid.io.runs import write_run
from resgrid.io.solutions import write_solution
from resgrid.planning.fields import Field
from resgrid.planning.lattice_fields import LatticeField
from resgrid.planning.legs import LegPath
from resgrid.planning.node_paths import NodePath
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Polyline, Streamline
from resgrid.planning.time_parameterization import Trajectory


def save(value: object, file: str | os.PathLike[str], **options: Any) -> Path:
    """Write a result to a file in the format that the file's suffix selects.  The file is written atomically.

    Parameters
    ----------
    value : Streamline, NodePath, ShortPath, Polyline, Trajectory, LegPath, Run, sequence of Run, OperatingPoint, ...
        Also a Field, a LatticeField, a Netlist, an EffectiveResistance, a Board or a Layout.  A path: its points in
        continuous world coordinates, with times if it has some, and the tip of an arm.  A run: every step.  An
        operating point or a field: potentials and currents.  A netlist: its elements.  Effective resistances: their
        pairs.  A board: its KiCad project.  A chip layout: its shapes, and a record of its circuit in
        ``FILE.record.json``.
    file : path-like
        ``-`` is standard output.  By type of value:

        =====================  ==========================================================================
        path                   ``.csv``, ``.json``, ``.npz``; ``.yaml``: a ``nav_msgs/Path`` for ROS, or, of a
                               trajectory of a robot from a URDF file, a ``trajectory_msgs/JointTrajectory``
        run, runs              ``.csv``, ``.json``, ``.npz``
        field, solved space    ``.npz``: ``potential``, ``log_drop``, ``cell``, perhaps ``safe``; of a lattice
                               ``points`` too
        other operating point  ``.csv``, ``.json``, ``.npz``, ``.raw`` (for waveform viewers)
        board                  a folder with a KiCad project
        resistances            ``.csv``, ``.json``, ``.npz``
        netlist                ``.txt`` (edge list), ``.graphml``, ``.json`` (node-link), ``.npz``
        layout                 ``.gds`` (GDSII), ``.oas`` (OASIS)
        =====================  ==========================================================================
    **options
        For ``.raw``: ``title``, the first line of the file, and ``form``, ``"binary"`` or ``"ascii"``.  For a
        JointTrajectory: ``fixed_joints``, whether it also has the joints that do not move
        (`resgrid.maps.to_ros_trajectory`).  For a layout: ``record``, whether to write the record; by default up to
        65,536 cells.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        If values of this type have no such format, the file cannot be written, an axis has the name of another column,
        or a message for ROS is asked of a path that reached no goal.

    Notes
    -----
    Decks are written by `resgrid.write_spice`, pictures by `resgrid.draw` and `resgrid.animate`.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((5.5, 2.5))
    >>> rg.save(path, "path.csv").read_text().splitlines()[:2]
    ['path,k,outcome,x,y', '0,1.0,reached,5.5,2.5']
    >>> with np.load(rg.save(path.field, "field.npz")) as arrays:
    ...     arrays["potential"].shape
    (8, 8)
    """
    writer = _save.dispatch(type(value))
    check_call("save", writer, (value, file), options, bound=2)
    return writer(value, file, **options)


@singledispatch
def _save(value: object, file: str | os.PathLike[str]) -> Path:
    """Write `value` if it is a sequence of runs, and return the file; raise InputError for values of other types."""
    if isinstance(value, Sequence) and value and all(isinstance(one, Run) for one in value):
        return write_run(value, file)
    raise InputError(
        f"{with_article(type(value).__name__)} has no file format; save takes a path, a run or runs, an operating "
        "point, a field, a netlist, effective resistances, a board or a layout (a deck: rg.write_spice; a picture: "
        "rg.draw)"
    )


for _kind in (Streamline, NodePath, ShortPath, Polyline, Trajectory):
    _save.register(_kind, write_path)
_save.register(LegPath, write_leg_path)
_save.register(OperatingPoint, write_solution)
_save.register(Field, write_solution)
_save.register(LatticeField, write_solution)
_save.register(Run, write_run)
_save.register(Netlist, write_network)
_save.register(Board, save_board)
_save.register(Layout, write_layout)
_save.register(EffectiveResistance, write_resistances)
