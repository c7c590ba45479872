"""A program with complete type annotations, as a user writes it; `make check` runs mypy on it in strict mode.

Each comment ``type: ignore`` marks a wrong call.  mypy reports a comment that it does not need, so that the check fails
if the stubs accept the call.
"""

import numpy as np
from numpy.typing import NDArray

import resgrid as rg


def shortest(file: str, start: tuple[float, float]) -> float:
    """Return the length of the path from a start on a map."""
    planner: rg.planning.Planner = rg.plan(rg.read_scene(file), edge="open")
    path: rg.Streamline | rg.planning.NodePath = planner.path(start)
    trajectory: rg.planning.Trajectory = rg.time_parameterize(rg.shortcut(path), velocity_limits=1.0)
    rg.save(trajectory, "path.csv")
    return path.length


def voltages(space: rg.ConfigurationSpace, options: rg.WiringOptions) -> NDArray[np.float64]:
    """Return the node voltages of the chip of a space."""
    netlist: rg.Netlist = rg.compile_space(space, rg.Wiring("neumann"), resistance=1e4)
    point: rg.OperatingPoint = rg.solve(netlist)
    warm: rg.circuit.WarmPoint = rg.circuit.WarmStart(**options).solve(space)
    return point.voltage if warm.fresh else warm.voltage


def sensitive(netlist: rg.Netlist) -> NDArray[np.float64] | None:
    """Return the derivatives of a log drop with respect to the conductivities of the cells."""
    found: rg.circuit.Gradient = rg.gradient(rg.solve(netlist), "log_drop", at=(1, 2), cells=True)
    return found.conductivity


def served(scene: rg.Scene) -> float:
    """Return the fraction of starts that a chip serves."""
    study: rg.chip.Study = rg.study(scene, boundary="dirichlet")
    result: rg.chip.Yield = study.yields(trials=10)
    return float(result.overall.value)


def message(error: rg.InputError) -> ValueError:
    """Return an error as the built-in exception that it derives from."""
    return error


version: str = rg.__version__


def wrong_calls() -> None:
    """Contain calls that mypy must reject; this function is never called."""
    rg.solve(5)  # type: ignore[arg-type]
    rg.plan(rg.read_scene("a.toml"), colour="red")  # type: ignore[call-arg]
    rg.compile_space(rg.build_space(rg.read_scene("a.toml")), resistence=1e3)  # type: ignore[call-arg]
    rg.study(rg.read_scene("a.toml")).settling(bit=3)  # type: ignore[call-arg]
    _length: str = rg.Axis("x", 0.0, 1.0, 4).lower  # type: ignore[assignment]
    rg.gradient(rg.solve(rg.Netlist(1, [], [])), "volts")  # type: ignore[arg-type]
    rg.streamlin  # type: ignore[attr-defined]  # noqa: B018
