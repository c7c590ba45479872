"""`StudyInputs`, base class of `Study`: the circuits and the operating point that several analyses use.

Also the decorator of the analyses, which checks their arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

from resgrid._internal.validation import check_call, guarded
from resgrid._internal.values import picture_of
from resgrid.chip.build import build_chip, described
from resgrid.chip.figures_of_merit import html_table, table_lines
from resgrid.chip.monte_carlo import die_temperature
from resgrid.circuit.nonlinear import linearize
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist
from resgrid.scene import Scene
from resgrid.scene.chip import Chip

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")


def checked_method(method: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Return a method of `Study` that first checks the names and types of its arguments.

    The returned method raises TypeError for an unknown option or too many positional arguments, and InputError for a
    value of another type than annotated.
    """
    method.__qualname__ = f"Study.{method.__name__}"  # the name in Python's own messages
    call = guarded(method.__name__, method)

    @wraps(method)
    def checked(*arguments: Parameters.args, **options: Parameters.kwargs) -> Returned:
        check_call(method.__name__, method, arguments, options, bound=1)
        result: Returned = call(*arguments, **options)
        return result

    return checked


@dataclass(frozen=True, eq=False, repr=False)
class StudyInputs:
    """Circuits and descriptions that the analyses of one chip share; each circuit is built and solved once.

    `ideal`: circuit before the effects of the chip; `chip`: chip description, None for a circuit without effects to
    add; `scene`: scene of the chip, None if the chip comes from a space or a netlist; `solved`: operating point of the
    circuit, None to compute it.
    """

    ideal: Netlist
    chip: Chip | None = None
    scene: Scene | None = None
    solved: OperatingPoint | None = None

    @cached_property
    def netlist(self) -> Netlist:
        """The circuit with all effects of the chip, as a netlist."""
        return self.ideal if self.chip is None else build_chip(self.ideal, self.chip)

    @cached_property
    def op(self) -> OperatingPoint:
        """The operating point of `netlist`, solved at the first access unless it was given."""
        return solve(self.netlist) if self.solved is None else self.solved

    @cached_property
    def linear(self) -> Netlist:
        """A linear circuit: `netlist`, or its linearization at the operating point if it has nonlinear resistors."""
        return linearize(self.op) if self.netlist.nonlinear_nodes.size else self.netlist

    @property
    def title(self) -> str:
        """Title for headings: the title of the scene, else the name of its file, else "chip"."""
        return (self.scene and (self.scene.title or Path(self.scene.source or "").stem)) or "chip"

    @property
    def description(self) -> Chip:
        """The chip description; ``Chip()``, an ideal chip, if none was given."""
        return self.chip or Chip()

    @property
    def bits(self) -> int:
        """Resolution of the read-out's converter in bits; 10 if the chip description states none."""
        return self.description.readout.bits or 10

    @property
    def span(self) -> float | None:
        """Width of the converter's range, in volts; None without a chip description.

        The range is that of the read-out in the chip description, or from 0 V to the magnitude of the supply if the
        description states none.
        """
        if self.chip is None:
            return None
        low, high = self.chip.readout.range or (0.0, abs(self.chip.supply))
        return high - low

    @property
    def temperature(self) -> float:
        """Temperature of the die, in kelvin; 300.15 K (27 degrees Celsius) if the chip description states none."""
        return die_temperature(self.description)

    @property
    def parameters(self) -> list[tuple[str, str, str]]:
        """Rows (key, value with unit, meaning) on the grid, the boundary and every set key of the chip description."""
        cells = self.ideal.cells
        return described(self.description, cells.space.shape, cells.wiring.boundary, cells.wiring.leak)

    def __repr__(self) -> str:
        cells = self.ideal.cell_map
        leak = f", leak {cells.wiring.leak:g}" if cells is not None and cells.wiring.leak else ""
        size = "" if cells is None else " x ".join(map(str, cells.space.shape))
        shape = "" if cells is None else f"{size} cells, {cells.wiring.boundary}{leak}, "
        return f"{type(self).__name__}({self.title}: {shape}{self.netlist.node_count} nodes)"

    def _repr_html_(self) -> str:
        picture = "" if self.ideal.cell_map is None else picture_of(self.ideal.cells.space)
        return picture + html_table(table_lines(("key", "value", "meaning"), self.parameters))
