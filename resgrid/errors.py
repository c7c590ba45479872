"""Everything that resgrid raises on purpose.

A message says what is wrong, where (file, line, key, cell), and what to do about it.  The command line turns each
class into an exit code; the library never exits.
"""

from __future__ import annotations

from collections.abc import Iterable


class ResgridError(Exception):
    """Base class of every error that resgrid raises on purpose.

    Examples
    --------
    >>> try:
    ...     rg.read_scene("nowhere.toml")
    ... except rg.ResgridError as error:
    ...     print(error)
    nowhere.toml: there is no such file; check the name and the folder
    """


class InputError(ResgridError):
    """A file, key, value or argument is wrong; the message names it and the remedy.

    Examples
    --------
    >>> rg.Axis("x", 1.0, 0.0, 4)
    Traceback (most recent call last):
        ...
    resgrid.errors.InputError: axis 'x': lower = 1.0 must lie below upper = 0.0
    """


class CircuitError(ResgridError):
    """The netlist has no operating point: nothing drives it, or its sources contradict each other.

    Examples
    --------
    >>> rg.solve(rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0], [1, 0]], source_volts=[1.0, 2.0]))
    Traceback (most recent call last):
        ...
    resgrid.errors.CircuitError: voltage source 1 between nodes node_1 and 0 contradicts ...
    """


class AccuracyError(ResgridError):
    """An answer was computed but does not keep the promised accuracy.

    Attributes
    ----------
    best : object or None
        The best answer there was, for inspection only.

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


class CertificateError(ResgridError):
    """A streamline breaks one of its promises; the message names the step and the promise.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> rg.certify_collision_free(rg.Polyline([(0.5, 6.5), (3.5, 3.5)], space))
    Traceback (most recent call last):
        ...
    resgrid.errors.CertificateError: segment 0 touches cell (1, 4), which is not free or outside the grid
    """


class ToolMissingError(ResgridError):
    """An outside program (a circuit simulator) is not installed; the message says how to get it.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> try:
    ...     agreement = rg.check_deck(netlist)
    ... except rg.ToolMissingError as error:
    ...     print(error)
    """


class BudgetError(ResgridError):
    """The job would not fit in the memory or time allowed; the message holds the estimate.

    Examples
    --------
    >>> axes = tuple(rg.Axis(name, 0.0, 1.0, 100_000) for name in "xyz")
    >>> rg.build_space(rg.Scene(axes, goals=(rg.GoalCell((0, 0, 0)),)))
    Traceback (most recent call last):
        ...
    resgrid.errors.BudgetError: scene: grid: 100000 x 100000 x 100000 = 1e+15 cells needs about ...
    """


class WorkerError(ResgridError):
    """Workers of an executor died again and again over the same work, which the message names.

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
    resgrid.errors.WorkerError: the executor broke (its threads do not start), and Broken cannot be made anew; ...
    """


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return the name that was probably meant, as a question; empty if none is near.

    Names that differ only in their digits, such as ros1 and ros2, mean different things.
    """
    from difflib import get_close_matches

    kin = name.rstrip("0123456789")
    candidates = [other for other in known if other.rstrip("0123456789") != kin or kin == name]
    near = [other for other in candidates if other.lower() == name.lower()] or get_close_matches(name, candidates, 1)
    return f"did you mean {near[0]!r}?" if near else ""
