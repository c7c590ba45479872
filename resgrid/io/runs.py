"""Writers of controlled runs: a log of every step, and the outcome of each run."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.control.run_log import ControlMode, Run
from resgrid.core.axis import Axis
from resgrid.io.tables import Views, require_names, suffix_of, write

_STEP = {"": "configuration", "_believed": "believed", "_rate": "velocity", "_torque": "torque", "_push": "push"}
"""Attributes of `Run` with one column per axis, by the text that follows the name of the axis in the column's name.

The velocity along ``x``, for example, is the column ``x_rate``.  `configuration`: true one; `believed`: according to
the position sensor; `torque`: generalised force of all contacts; `push`: external generalised force.
"""

_CONTACT = ("contact_x", "contact_y", "force_x", "force_y", "part", "body", "sticking")
"""Names of the columns of the contact with the largest force in a time step, empty in steps without contact.

`contact_x`, `contact_y`: touched point, in metres; `force_x`, `force_y`: force on the robot, in world axes, in the unit
for which force times `Control.admittance` is a velocity; `part`: index of the robot's part that touches; `body`: index
of the touched obstacle; `sticking`: 1 if friction holds the contact, else 0.
"""


def write_run(run: Run | Sequence[Run], file: str | os.PathLike[str]) -> Path:
    """Write all steps of one or several runs.  The file is written atomically.

    Parameters
    ----------
    run : Run or sequence of Run
        Runs to write.
    file : path-like
        ``.csv``, or ``-`` for standard output: table with one step per line, in world coordinates, with the strongest
        contact of the step; ``.json``: outcome and all columns of each run; ``.npz``: the arrays of run ``i``, with the
        suffix ``_i``.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the suffix is unknown, an axis has the name of another column, or the file cannot be written.

    Examples
    --------
    >>> run = rg.simulation(rg.read_scene("examples/scenes/lesson.toml"), k=0.9).run()
    >>> rg.save(run, "run.csv").read_text().split(",")[:6]
    ['run', 'k', 't', 'mode', 'x', 'y']
    """
    runs = [run] if isinstance(run, Run) else list(run)
    return write(file, _views(runs), "a run")


def check_run_file(file: str | os.PathLike[str], axes: Sequence[Axis] = ()) -> None:
    """Raise InputError if runs cannot be written to a file of this name, because of its suffix or a column name.

    `axes`: axes of the runs, empty if unknown, which omits the check of the names.
    """
    if suffix_of(file, _views(()), "a run") == ".csv":
        require_names(axes, _names(axes))


def run_record(run: Run) -> dict[str, Any]:
    """Return the totals of a run as a dictionary for JSON.

    Keys: ``outcome`` and ``message``: reason of the end; ``goal``: index of the reached region, or None; ``start``,
    ``end``: configurations; ``k``: weight of the Dirichlet field; ``time`` in seconds; ``steps``; ``modes``: number of
    recorded times by control mode; ``cells_learnt``: number of cells that contacts added as obstacles; ``resolves``:
    number of solves after such contacts; ``contacts``: number of contacts with a force; ``parts_touched``: indices of
    the robot's parts; ``penetration``: largest depth in an obstacle, in metres; ``goal_distance``: distance from the
    nearest goal at the end, in metres, or in axis units for a goal cell or joint angles; ``unsolved``: number of steps
    in which no contact forces could be computed.
    """
    modes, counts = np.unique(run.mode, return_counts=True)
    return {
        "outcome": str(run.ending),
        "message": run.message,
        "goal": run.goal,
        "start": run.configuration[0],
        "end": run.configuration[-1],
        "k": run.field.k,
        "time": run.time[-1],
        "steps": len(run.time) - 1,
        "modes": {
            ControlMode(mode).name.lower(): count for mode, count in zip(modes.tolist(), counts.tolist(), strict=True)
        },
        "cells_learnt": int(run.learnt.sum()),
        "resolves": len(run.lessons),
        "contacts": len(run.contacts.step),
        "parts_touched": np.unique(run.contacts.part),
        "penetration": run.penetration,
        "goal_distance": run.goal_distance,
        "unsolved": run.unsolved,
    }


def _views(runs: Sequence[Run]) -> Views:
    """Return functions that return the contents of a file of runs, under the keys ``table``, ``record`` and ``arrays``.

    The keys stand for CSV, JSON and NPZ files.
    """
    return {"table": lambda: _table(runs), "record": lambda: _record(runs), "arrays": lambda: _arrays(runs)}


def _names(axes: Sequence[Axis]) -> list[str]:
    """Return the names of the columns of a table of runs: totals of a step, values per axis, strongest contact."""
    return [
        "run", "k", "t", "mode", *(axis.name + end for end in _STEP for axis in axes), "contacts", *_CONTACT,
    ]  # fmt: skip


def _table(runs: Sequence[Run]) -> dict[str, list[Any]]:
    """Return the columns of a table of all runs by name, with one row per time step.

    The first two columns are ``run`` (index of the run) and ``k``.
    """
    names = _names(runs[0].space.axes)
    require_names(runs[0].space.axes, names)
    rows = [(number, run.field.k, *row) for number, run in enumerate(runs) for row in _rows(run)]
    return dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))


def _rows(run: Run) -> list[list[Any]]:
    """Return the rows of one run: time, mode, values per axis, number of contacts, and the strongest contact.

    The strongest contact of a step has the largest force.  Its entries are point, force, part of the robot, touched
    obstacle, and whether friction holds it; None in steps without contact.
    """
    contacts = run.contacts
    size = np.hypot(*contacts.force.T)
    values = np.hstack([getattr(run, name) for name in _STEP.values()]).tolist()
    rows = []
    for step, (time, mode) in enumerate(zip(run.time.tolist(), run.mode.tolist(), strict=True)):
        first, last = np.searchsorted(contacts.step, [step, step + 1]).tolist()
        strongest: list[Any] = [None] * len(_CONTACT)
        if last > first:
            one = first + int(np.argmax(size[first:last]))
            strongest = [*contacts.point[one].tolist(), *contacts.force[one].tolist()]
            strongest += [int(column[one]) for column in (contacts.part, contacts.body, contacts.sticking)]
        rows.append([time, ControlMode(mode).name.lower(), *values[step], last - first, *strongest])
    return rows


def _arrays(runs: Sequence[Run]) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of all controlled runs by name.

    With one entry per run: ``k`` (weight of the Dirichlet field), ``start`` (configuration) and ``outcome``.
    ``mode_names``: names of the control modes, by number.  The log of run ``i`` is in arrays with the suffix ``_i``,
    such as ``time_0``, with one entry per time step, or with one entry per contact (``contact_force_0``).
    """
    arrays: dict[str, NDArray[np.generic]] = {
        "k": np.array([run.field.k for run in runs]),
        "start": np.array([run.configuration[0] for run in runs]),
        "outcome": np.array([str(run.ending) for run in runs]),
        "mode_names": np.array([mode.name.lower() for mode in ControlMode]),
    }
    for number, run in enumerate(runs):
        arrays |= {f"{name}_{number}": column for name, column in _columns(run).items()}
    return arrays


def _record(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the names of the control modes, and outcome and columns of each run, as a dictionary for JSON.

    Keys: ``mode_names``, in the order of the numbers in the column ``mode``; ``runs``: for each run the dictionary of
    `run_record` with the additional key ``columns`` (arrays by name).
    """
    return {
        "mode_names": [mode.name.lower() for mode in ControlMode],
        "runs": [run_record(run) | {"columns": _columns(run)} for run in runs],
    }


def _columns(run: Run) -> dict[str, NDArray[np.generic]]:
    """Return all arrays of a run by name, in world coordinates, with one entry per time step or per contact.

    Arrays over the contacts have names that begin with ``contact_``.  The array ``learnt`` is a mask of cells.
    """
    columns = {name: getattr(run, name) for name in ("time", "mode", *_STEP.values(), "learnt")}
    return columns | {f"contact_{name}": column for name, column in vars(run.contacts).items()}
