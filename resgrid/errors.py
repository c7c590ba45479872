"""Exceptions of resgrid, and suggestions for misspelt names.

A message states the problem, the place of the problem (file, line, key, cell) and a remedy.  Every exception also
derives from the matching built-in class, so that ``except ValueError`` catches an `InputError`.  The command line maps
each class to an exit code; the library never exits.
"""

from __future__ import annotations

from collections.abc import Iterable


class ResgridError(Exception):
    """Base class of all exceptions that resgrid raises for foreseen problems.

    Examples
    --------
    >>> try:
    ...     rg.read_scene("nowhere.toml")
    ... except rg.ResgridError as error:
    ...     print(error)
    nowhere.toml: there is no such file; check the name and the folder
    """


class InputError(ResgridError, ValueError):
    """A file, key, value or argument is invalid; the message states the invalid part and a remedy.

    Examples
    --------
    >>> rg.Axis("x", 1.0, 0.0, 4)
    Traceback (most recent call last):
        ...
    resgrid.errors.InputError: axis 'x': lower = 1.0 must lie below upper = 0.0
    """


class CircuitError(ResgridError, ArithmeticError):
    """The netlist has no operating point: no source drives it, or its sources contradict each other.

    Examples
    --------
    >>> rg.solve(rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0], [1, 0]], source_volts=[1.0, 2.0]))
    Traceback (most recent call last):
        ...
    resgrid.errors.CircuitError: voltage source 1 between nodes node_1 and 0 contradicts ...
    """


class AccuracyError(ResgridError, ArithmeticError):
    """The computed result does not have the requested accuracy.

    Attributes
    ----------
    best : object or None
        The most accurate result that was computed, for inspection only; None if there is no such result.

    Examples
    --------
    >>> ideal = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")), rails="cells")
    >>> poor = rg.chip.build_chip(ideal, rg.Chip(obstacle_switch_on="100k"))
    >>> try:
    ...     field = rg.field(rg.solve(poor))
    ... except rg.AccuracyError as error:
    ...     print(error.best)
    <Field on 8 x 8 cells: dirichlet, k = 1>
    """

    def __init__(self, message: str, best: object | None = None) -> None:
        super().__init__(message)
        self.best = best


class CertificateError(ResgridError, ValueError):
    """A path does not have a property that a certificate needs; the message names the property and, if known, the step.

    Such properties are a descending potential, the absence of collisions, and a correct length and clearance.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> rg.certify_collision_free(rg.Polyline([(0.5, 6.5), (3.5, 3.5)], space))
    Traceback (most recent call last):
        ...
    resgrid.errors.CertificateError: segment 0 touches cell (1, 4), which is not free or outside the grid
    """


class ToolMissingError(ResgridError, OSError):
    """A program or an optional package is not installed; the message contains the command that installs it.

    Most tools are programs, and Python reports a missing program as an OSError (`FileNotFoundError`).  The attributes
    ``errno``, ``strerror`` and ``filename`` are None.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> try:
    ...     agreement = rg.check_deck(netlist)
    ... except rg.ToolMissingError as error:
    ...     print(error)
    """


class BudgetError(MemoryError, ResgridError):
    """The job needs more memory, disk space or time than its limit; the message contains the estimated need.

    Examples
    --------
    >>> axes = tuple(rg.Axis(name, 0.0, 1.0, 100_000) for name in "xyz")
    >>> rg.build_space(rg.Scene(axes, goals=(rg.GoalCell((0, 0, 0)),)))
    Traceback (most recent call last):
        ...
    resgrid.errors.BudgetError: scene: grid: 100000 x 100000 x 100000 = 1e+15 cells needs about ...
    """


class WorkerError(ResgridError, RuntimeError):
    """Workers of an executor died repeatedly while they computed the same items; the message names these items.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> from concurrent.futures.thread import BrokenThreadPool
    >>> class Broken(ThreadPoolExecutor):
    ...     def submit(self, *_work):
    ...         raise BrokenThreadPool("its threads do not start")
    >>> list(rg.spread(abs, [-1], executor=Broken()))
    Traceback (most recent call last):
        ...
    resgrid.errors.WorkerError: the executor broke (its threads do not start), and a Broken cannot be restarted; ...
    """


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return a question that proposes the most similar known name; an empty string if no known name is similar.

    `name`: misspelt name; `known`: valid names.  A known name that differs only in upper and lower case is preferred.
    If `name` ends in digits, known names that differ only in these digits are not proposed: ros1 is not ros2.
    """
    from difflib import get_close_matches

    stem = name.rstrip("0123456789")
    candidates = [other for other in known if other.rstrip("0123456789") != stem or stem == name]
    same = [other for other in candidates if other.lower() == name.lower()]
    similar = same or get_close_matches(name, candidates, 1)
    return f"did you mean {similar[0]!r}?" if similar else ""
