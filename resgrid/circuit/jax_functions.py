"""Circuits as differentiable functions of jax, with the adjoint of `resgrid.circuit.gradients` as their derivative."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.extras import install_command
from resgrid.circuit.gradients import pullback
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import CircuitLike, netlist_of, solve
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError, ToolMissingError
from resgrid.solvers.method_choice import check_method

Output = Literal["voltage", "log_drop"]
Input = Literal["conductance", "conductivity", "voltage", "current"]

_FIELDS = {"conductance": "conductance", "voltage": "source_volts", "current": "current_amps"}
"""Name of the field of a netlist that contains an input, by the name of the input.

Conductivities have no such field.
"""


def jax_solver(
    netlist: Netlist | CircuitLike,
    output: Output = "voltage",
    *,
    inputs: Sequence[Input] = ("conductance",),
    method: str = "auto",
) -> Callable[..., Any]:
    """Return a function of jax that solves a circuit, differentiable by `jax.grad` and `jax.vjp`.

    The function runs outside of jax, on the host, by `resgrid.solve` and `resgrid.circuit.pullback`
    (``jax.pure_callback`` and ``jax.custom_vjp``).  It works within ``jax.jit``, and within ``jax.vmap``, which solves
    the circuits one after another.  Forward-mode derivatives (``jax.jvp``) and second derivatives do not exist.

    Parameters
    ----------
    netlist : Netlist or Circuit
        The circuit.
    output : {"voltage", "log_drop"}
        Result of the function: node voltages in volts, or the natural logarithms of the drops of the nodes from the
        high rail.  Log drops exist only with two rails.
    inputs : sequence of {"conductance", "conductivity", "voltage", "current"}
        Arguments of the function, in this order: conductances of the resistors in siemens, or conductivities of the
        cells of a compiled space; voltages of the voltage sources in volts; currents of the current sources in amperes.
        Other values are those of `netlist`.
    method : {"auto", "direct", "multigrid"}
        Method for the linear systems; ``"auto"`` chooses by size and shape.

    Returns
    -------
    callable
        Function of one jax array of float64 per input; it returns a jax array of float64, shape (nodes,).  An error of
        resgrid, as for a negative conductance, appears as an error of the callback.

    Raises
    ------
    InputError
        If the method or an input is unknown, an input is missing or given twice, conductances and conductivities are
        both inputs, or the conductances of the netlist are not those of its compiled space; or, in a call, jax has no
        float64 numbers.
    ToolMissingError
        If jax is not installed.

    Examples
    --------
    >>> import jax
    >>> jax.config.update("jax_enable_x64", True)
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 3e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> voltages = rg.circuit.jax_solver(divider)
    >>> jax.grad(lambda g: voltages(g)[2])(divider.conductance)
    Array([ 375., -125.], dtype=float64)
    """
    check_method(method)
    jax = _imported_jax()
    host = _Host(netlist_of(netlist), output, _checked_inputs(inputs), method)
    if "conductivity" in host.inputs:
        host.require_compiled()

    def shapes(arrays: Sequence[NDArray[np.float64]]) -> tuple[Any, ...]:
        return tuple(jax.ShapeDtypeStruct(array.shape, np.float64) for array in arrays)

    (result,), given = shapes([np.empty(host.netlist.node_count)]), shapes(host.defaults())

    def forward_only(*values: Any) -> Any:
        return jax.pure_callback(host.solve, result, *values, vmap_method="sequential")

    def forward(*values: Any) -> tuple[Any, Any]:
        return solved(*values), values

    def backward(values: Any, seed: Any) -> Any:
        return jax.pure_callback(host.pull_back, given, seed, *values, vmap_method="sequential")

    solved = jax.custom_vjp(forward_only)
    solved.defvjp(forward, backward)

    def function(*values: Any) -> Any:
        if not jax.config.jax_enable_x64:
            raise InputError(
                'jax computes in float32, too coarse for voltages; call jax.config.update("jax_enable_x64", True) first'
            )
        if len(values) != len(given):
            raise InputError(f"{len(values)} arguments are given for the inputs {', '.join(host.inputs)}; give each")
        arrays = [jax.numpy.asarray(value, dtype=np.float64) for value in values]
        for name, array, default in zip(host.inputs, arrays, given, strict=True):
            if array.shape != default.shape:
                raise InputError(f"{name} has shape {array.shape}; give an array of shape {default.shape}")
        return solved(*arrays)

    return function


@dataclass(frozen=True, eq=False)
class _Host:
    """A circuit with the functions that jax calls on the host: solve, and multiply weights with the Jacobian matrix.

    `netlist`: the circuit; `output`: ``"voltage"`` or ``"log_drop"``; `inputs`: names of the arguments,
    ``"conductance"``, ``"conductivity"``, ``"voltage"`` or ``"current"``; `method`: method of the linear systems.
    """

    netlist: Netlist
    output: str
    inputs: tuple[str, ...]
    method: str

    def defaults(self) -> list[NDArray[np.float64]]:
        """Return the values of the netlist for every input, as a list of arrays in the order of the inputs."""
        return [
            _conductivity(self.netlist.cells.space) if name == "conductivity" else getattr(self.netlist, _FIELDS[name])
            for name in self.inputs
        ]

    def require_compiled(self) -> None:
        """Raise InputError unless the conductances are those of the compiled space."""
        netlist = self.netlist
        compiled = self._compiled(_conductivity(netlist.cells.space)).conductance
        if netlist.nonlinear_nodes.size or not np.array_equal(compiled, netlist.conductance):
            raise InputError(
                "the resistors of the netlist differ from those of its compiled space, so that conductivities do not "
                "determine them; give the result of rg.compile_space, or inputs=('conductance',)"
            )

    def solve(self, *values: Any) -> NDArray[np.float64]:
        """Return the node voltages in volts, or the log drops, (nodes,); `values`: an array per input."""
        found = getattr(self._point(*values), self.output)
        if found is None:
            raise InputError(
                "the circuit has no log_drop, because not exactly two known voltages drive it; choose output='voltage'"
            )
        return np.array(found)

    def pull_back(self, seed: Any, *values: Any) -> tuple[NDArray[np.float64], ...]:
        """Return the derivatives of the weighted sum of the outputs with respect to the inputs, an array per input.

        `seed` (nodes,): weights of the outputs; `values`: an array per input.
        """
        seeds = {self.output: np.asarray(seed)}
        found = pullback(self._point(*values), method=self.method, **seeds)
        return tuple(np.array(getattr(found, name)) for name in self.inputs)

    def _point(self, *values: Any) -> OperatingPoint:
        """Return the operating point for the values of the inputs; the reverse pass reuses that of the forward pass."""
        return self._solved(*(np.asarray(value, dtype=np.float64).tobytes() for value in values))

    @cached_property
    def _solved(self) -> Callable[..., OperatingPoint]:
        """Function from the values of the inputs, as bytes of float64 arrays, to the operating point.

        The results for the last four sets of values are stored.
        """

        @lru_cache(maxsize=4)
        def solved(*values: bytes) -> OperatingPoint:
            arrays = [
                np.frombuffer(value).reshape(old.shape) for value, old in zip(values, self.defaults(), strict=True)
            ]
            return solve(self.changed(arrays), method=self.method)

        return solved

    def changed(self, values: Sequence[NDArray[np.float64]]) -> Netlist:
        """Return the netlist with other values of the inputs; `values`: an array per input."""
        changes: dict[str, Any] = {}
        for name, value in zip(self.inputs, values, strict=True):
            if name == "conductivity":
                # Derivatives with respect to conductivities are taken at the space of the cell map.
                compiled = self._compiled(value)
                changes |= {"conductance": compiled.conductance, "cell_map": compiled.cell_map}
            else:
                changes[_FIELDS[name]] = value
        return self.netlist.replace(**changes)

    def _compiled(self, conductivity: NDArray[np.float64]) -> Netlist:
        """Return the compiled netlist of the space with other conductivities.

        `conductivity` (shape of the space): conductivities of the cells, factors without unit.
        """
        cells = self.netlist.cells
        return compile_space(ConfigurationSpace(cells.space.axes, cells.space.cell, conductivity), cells.wiring)


def _conductivity(space: ConfigurationSpace) -> NDArray[np.float64]:
    """Return the conductivities of a space, 1 by default, (shape of the space)."""
    return np.ones(space.shape) if space.conductivity is None else space.conductivity


def _checked_inputs(inputs: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the inputs as a tuple.

    Raise InputError without a name, for repeated names, and for conductances and conductivities at the same time.
    """
    names = tuple(inputs)
    if not names or len(set(names)) < len(names) or {"conductance", "conductivity"} <= set(names):
        raise InputError(
            f"inputs = {names!r} must name each input once, with conductance or conductivity but not both, such as "
            "inputs=('conductivity',)"
        )
    return names


def _imported_jax() -> Any:
    """Return the module jax; raise ToolMissingError, with the command of the installation, if it is missing."""
    try:
        return importlib.import_module("jax")
    except ImportError as error:
        raise ToolMissingError(
            f"differentiable solvers need the package jax; install it with: {install_command('jax')} ({error})"
        ) from None
