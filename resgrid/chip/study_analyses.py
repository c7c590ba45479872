"""One chip under study: its circuit, made once, and what the analyses say of it."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, wraps
from operator import attrgetter
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar, Unpack, cast

from numpy.typing import ArrayLike

from resgrid._internal.validation import check_call, guarded
from resgrid._internal.values import picture_of
from resgrid.chip.adc_resolution import analyse_precision
from resgrid.chip.build import build_chip, conductance_samples, described, ideal_netlist
from resgrid.chip.decks import noise_band, write_decks
from resgrid.chip.fault_analysis import analyse_criticality
from resgrid.chip.figures_of_merit import html_table, table_lines
from resgrid.chip.monte_carlo import die_temperature
from resgrid.chip.noise import analyse_noise, noise_covariance, noise_density
from resgrid.chip.power import analyse_power
from resgrid.chip.sensitivity import Sensitivity, analyse_sensitivity, voltage_sensitivity
from resgrid.chip.settling import Settling, analyse_settling
from resgrid.chip.sweeps import explore_yield
from resgrid.chip.yield_loss import analyse_yield_loss
from resgrid.chip.yields import analyse_yield
from resgrid.circuit.nonlinear import linearize
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, check_wiring_options, wiring_of
from resgrid.errors import InputError
from resgrid.planning.pipeline import problem_of
from resgrid.planning.trace import start_cell
from resgrid.scene import Scene
from resgrid.scene.chip import Chip
from resgrid.spice.write.files import WrittenDeck

Rest = ParamSpec("Rest")
Asked = TypeVar("Asked", Netlist, OperatingPoint)
Answer = TypeVar("Answer")


def _question(
    analyse: Callable[Concatenate[Asked, Rest], Answer], circuit: str, **usual: str
) -> Callable[Concatenate[Study, Rest], Answer]:
    """An analysis as a method, of one of a study's circuits; what is not said, attributes of the study say."""
    answer = guarded(analyse.__name__, analyse)

    @wraps(analyse)
    def ask(study: Study, *arguments: Rest.args, **options: Rest.kwargs) -> Answer:
        check_call(_METHODS[analyse], analyse, (study, *arguments), options, bound=1)
        unsaid = {name: attrgetter(path)(study) for name, path in usual.items() if options.get(name) is None}
        return cast("Answer", answer(getattr(study, circuit), *arguments, **{**options, **unsaid}))

    return ask  # type: ignore[return-value]


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """One chip, and every question that can be asked about it; made by `study`.

    Attributes
    ----------
    ideal : Netlist
        The circuit before the chip's effects, a uniform drive scaled to the supply.
    chip : Chip or None
        What its maker says about it; None for a netlist or an operating point as it is.
    scene : Scene or None
        Where it comes from.

    Examples
    --------
    >>> study = rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip(capacitance="100f", mismatch="2 %"))
    >>> print(study.settling().figures["settle_time"])
    11.28 ns
    >>> print(study.power().figures["power"])
    246.4 µW
    >>> print(study.yields(trials=64).overall)
    100.0 % (94.3 to 100.0 %)
    """

    ideal: Netlist
    chip: Chip | None = None
    scene: Scene | None = None
    solved: OperatingPoint | None = None

    @cached_property
    def netlist(self) -> Netlist:
        """The chip's circuit."""
        return self.ideal if self.chip is None else build_chip(self.ideal, self.chip)

    @cached_property
    def op(self) -> OperatingPoint:
        """The circuit's operating point, solved when it is first asked for."""
        return solve(self.netlist) if self.solved is None else self.solved

    @cached_property
    def linear(self) -> Netlist:
        """The circuit, or its small signals around the operating point where it is nonlinear."""
        return linearize(self.op) if self.netlist.nonlinear_nodes.size else self.netlist

    @property
    def title(self) -> str:
        """The scene's, for headings."""
        return (self.scene and (self.scene.title or Path(self.scene.source or "").stem)) or "chip"

    @property
    def description(self) -> Chip:
        """What its maker says about it; an ideal chip where nothing is said."""
        return self.chip or Chip()

    @property
    def bits(self) -> int:
        """Of the converter; 10 where it is ideal, for comparison."""
        return self.description.readout.bits or 10

    @property
    def span(self) -> float | None:
        """Range of the converter, in volts; None where no description says it."""
        if self.chip is None:
            return None
        low, high = self.chip.readout.range or (0.0, abs(self.chip.supply))
        return high - low

    @property
    def temperature(self) -> float:
        """Of the die, in kelvin."""
        return die_temperature(self.description)

    @property
    def _settling_bits(self) -> int:
        return min(self.bits, 24)

    @property
    def parameters(self) -> list[tuple[str, str, str]]:
        """What is said of the chip, key by key, without what is ideal: key, value, meaning."""
        cells = self.ideal.cells
        return described(self.description, cells.space.shape, cells.wiring.boundary)

    @cached_property
    def usual_settling(self) -> Settling:
        """How it settles to the bits and range of its own converter."""
        return self.settling()

    @cached_property
    def _band(self) -> tuple[float, float] | None:
        if self.description.readout.noise_bandwidth is not None:
            return 0.0, self.description.readout.noise_bandwidth
        if self.chip is None or not self.netlist.capacitance.any():
            return None
        return 0.0, noise_band(self.usual_settling)[1]

    settling = _question(analyse_settling, "linear", bits="_settling_bits", span="span")
    noise = _question(analyse_noise, "linear", band="_band", temperature="temperature")
    noise_density = _question(noise_density, "linear", temperature="temperature")
    noise_covariance = _question(noise_covariance, "linear", temperature="temperature")
    power = _question(analyse_power, "op")
    precision = _question(analyse_precision, "op", span="span")
    voltage_sensitivity = _question(voltage_sensitivity, "op")
    yields = _question(analyse_yield, "ideal", chip="description")
    yield_loss = _question(analyse_yield_loss, "ideal", chip="description")
    exploration = _question(explore_yield, "ideal", chip="description")
    conductances = _question(conductance_samples, "ideal", chip="description")
    criticality = _question(
        analyse_criticality,
        "netlist",
        readout="description.readout",
        short_resistance="description.defects.short_resistance",
    )

    def sensitivity(self, cells: ArrayLike | None = None) -> Sensitivity:
        """Which resistors can change a robot's steps.

        `cells` (axes,) or (k, axes): one cell, or all cells of a path (goal cells among them are left out), each of
        which costs one solution; by default those on the way from the scene's starts, or from the start that needs most
        bits.

        Raises
        ------
        AccuracyError
            If the derivatives cannot be found well enough.
        """
        if cells is None:
            space = self.netlist.cells.space
            starts = () if self.scene is None else self.scene.starts
            cells = self.precision().cells_passed([start_cell(space, start) for start in starts])
        return analyse_sensitivity(self.op, cells)

    def write_decks(
        self, folder: str | os.PathLike[str], *, title: str | None = None, dialect: str = "ngspice"
    ) -> dict[str, WrittenDeck]:
        """Write the chip's decks into a folder that exists, each with its expected answer in the sidecar.

        `title`: first line of the decks, the scene's by default; `dialect`: which simulator they are for.  Returns what
        was written, by ``"op"``, ``"transient"`` and ``"noise"`` (chips with capacitance) and ``"temperature"``.
        """
        settling = self.usual_settling if self.netlist.capacitance.any() else None
        words = {"title": title or self.title, "dialect": dialect}
        return write_decks(self.op, self.linear, settling, self.ideal, self.description, Path(folder), words)

    def __repr__(self) -> str:
        cells = self.ideal.cell_map
        shape = "" if cells is None else f"{' x '.join(map(str, cells.space.shape))} cells, {cells.wiring.boundary}, "
        return f"Study({self.title}: {shape}{self.netlist.node_count} nodes)"

    def _repr_html_(self) -> str:
        picture = "" if self.ideal.cell_map is None else picture_of(self.ideal.cells.space)
        return picture + html_table(table_lines(("key", "value", "meaning"), self.parameters))


_METHODS: dict[Callable[..., Any], str] = {
    ask.__wrapped__: name for name, ask in vars(Study).items() if hasattr(ask, "__wrapped__")
}
"""Names of the methods that ask analyses, for messages."""


def study(
    source: Scene | ConfigurationSpace | Netlist | OperatingPoint,
    chip: Chip | None = None,
    wiring: Wiring | None = None,
    *,
    space: ConfigurationSpace | None = None,
    **options: Unpack[WiringOptions],
) -> Study:
    """Put a chip under study, to find out whether it is good enough to drive a robot.

    Parameters
    ----------
    source : Scene, ConfigurationSpace, Netlist or OperatingPoint
        Where the chip comes from.  A scene describes it in ``[chip]``; a space is compiled with one node per cell; a
        netlist (of a deck, say) is an ideal one where a chip is given, else it is studied as it is.
    chip : Chip, optional
        Its description, in place of the scene's.
    wiring : Wiring, optional
        Boundary conditions and element values of a scene or a space; by default those of the scene.
    space : ConfigurationSpace, optional
        Of the scene, where it has been sampled already.
    **options
        Fields of `Wiring`, such as ``boundary="neumann"``: instead of a wiring, or changes to it.

    Returns
    -------
    Study

    Raises
    ------
    InputError
        If the chip or an option does not fit the source.
    CircuitError
        If nothing drives the circuit of a scene.

    Examples
    --------
    >>> chip = rg.Chip(mismatch=0.02, readout=rg.chip.Readout(bits=8))
    >>> study = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip)
    >>> study
    Study(Eight by eight: 8 x 8 cells, dirichlet, 66 nodes)
    >>> study.precision().sentence(12)
    'a 12-bit read-out serves 100 % of the starts'
    """
    check_wiring_options(options)
    if isinstance(source, Netlist | OperatingPoint):
        given = [*options, *(name for name, value in (("wiring", wiring), ("space", space)) if value is not None)]
        if given:
            raise InputError(f"{', '.join(given)}: a circuit is wired already; give a scene or a space")
        netlist = source if isinstance(source, Netlist) else source.netlist
        solved = source if chip is None and isinstance(source, OperatingPoint) else None
        return Study(netlist, chip, solved=solved)
    if isinstance(source, ConfigurationSpace):
        chip = chip or Chip()
        default = {"wall_resistance": chip.wall_resistance} if options.get("boundary") == "wall" else {}
        return Study(ideal_netlist(source, chip, wiring_of(wiring, options, default)), chip)
    scene = source if chip is None else dataclasses.replace(source, chip=chip)
    problem = problem_of(scene, wiring, space=space, **options)
    chip = chip or source.chip
    return Study(ideal_netlist(problem.space, chip, problem.only_wiring()[1]), chip, source)
