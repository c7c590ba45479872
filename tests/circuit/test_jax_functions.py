"""Differentiable solvers for jax: numerical checks of gradients, jit, vmap, conductivities, and rejected calls."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from support.mpmath_circuits import comb

import resgrid as rg

jax = pytest.importorskip("jax")
test_util = pytest.importorskip("jax.test_util")


@pytest.fixture(autouse=True)
def double_precision() -> Iterator[None]:
    """Numbers of float64 in jax during a test."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def bridge() -> rg.Netlist:
    """A bridge of five resistors with a voltage source and a current source."""
    return rg.Netlist(
        4, [[1, 2], [1, 3], [2, 3], [2, 0], [3, 0]], [1.0, 2.0, 0.5, 1.5, 0.7], source_nodes=[[1, 0]],
        source_volts=[1.0], current_nodes=[[0, 3]], current_amps=[0.2],
    )  # fmt: skip


def test_jax_confirms_the_derivatives_of_all_inputs() -> None:
    netlist = bridge()
    voltages = rg.circuit.jax_solver(netlist, inputs=("conductance", "voltage", "current"))
    values = netlist.conductance, netlist.source_volts, netlist.current_amps

    def loss(g: Any, volts: Any, amps: Any) -> Any:
        return jax.numpy.sum(jax.numpy.sin(voltages(g, volts, amps)))

    test_util.check_grads(loss, values, order=1, modes=["rev"], eps=1e-5, rtol=1e-7)
    np.testing.assert_array_equal(voltages(*values), rg.solve(netlist).voltage)
    found = jax.jit(jax.grad(loss, argnums=(0, 1, 2)))(*values)
    wanted = rg.gradient(rg.solve(netlist), np.cos(rg.solve(netlist).voltage))
    for name, derivative in zip(("conductance", "voltage", "current"), found, strict=True):
        np.testing.assert_allclose(derivative, getattr(wanted, name), rtol=1e-12)


def test_log_drops_far_below_the_range_of_doubles_are_differentiable() -> None:
    netlist = comb(12, 1e30)
    drops = rg.circuit.jax_solver(netlist, "log_drop")
    log_g = jax.numpy.log(jax.numpy.asarray(netlist.conductance))
    nodes = np.array([3, 8, 14])

    def loss(x: Any) -> Any:
        return jax.numpy.sum(drops(jax.numpy.exp(x))[nodes])

    assert loss(log_g) < -1000
    test_util.check_grads(loss, (log_g,), order=1, modes=["rev"], eps=1e-4, rtol=1e-7)


@pytest.mark.slow
def test_conductivities_of_a_space_are_inputs() -> None:
    rng = np.random.default_rng(2)
    cell = np.zeros((5, 4), dtype=np.uint8)
    cell[0, 0], cell[2, 1:3] = rg.Cell.GOAL, rg.Cell.OBSTACLE
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 5, 5), rg.Axis("y", 0, 8, 4)], cell)
    netlist = rg.compile_space(space, boundary="wall", wall_resistance=3.0, resistance=1.0)
    drops = rg.circuit.jax_solver(netlist, "log_drop", inputs=("conductivity",))
    nodes = netlist.cells.node[[4, 1, 3], [3, 2, 0]]

    def loss(x: Any) -> Any:
        return jax.numpy.sum(drops(jax.numpy.exp(x))[nodes] ** 2)

    x = rng.normal(size=space.shape)
    test_util.check_grads(loss, (x,), order=1, modes=["rev"], eps=1e-4, rtol=1e-6)
    batch = np.stack([x, 0 * x, -x])
    np.testing.assert_allclose(jax.vmap(loss)(batch), [loss(each) for each in batch], rtol=1e-12)
    np.testing.assert_allclose(jax.vmap(jax.grad(loss))(batch)[2], jax.grad(loss)(-x), rtol=1e-9)


def test_rejected_calls_name_the_remedy() -> None:
    netlist = bridge()
    with pytest.raises(rg.InputError, match="must name each input once"):
        rg.circuit.jax_solver(netlist, inputs=("conductance", "conductivity"))
    with pytest.raises(rg.InputError, match="method = 'fast' is unknown"):
        rg.circuit.jax_solver(netlist, method="fast")
    with pytest.raises(rg.InputError, match="not compiled from a space"):
        rg.circuit.jax_solver(netlist, inputs=("conductivity",))
    compiled = rg.compile_space(rg.build_space(rg.read_scene("lesson.toml")))
    changed = compiled.replace(conductance=2 * compiled.conductance)
    with pytest.raises(rg.InputError, match=r"the result of rg\.compile_space"):
        rg.circuit.jax_solver(changed, inputs=("conductivity",))
    voltages = rg.circuit.jax_solver(netlist)
    with pytest.raises(rg.InputError, match=r"shape \(3,\); give an array of shape \(5,\)"):
        voltages(np.ones(3))
    with pytest.raises(rg.InputError, match="2 arguments are given for the inputs conductance"):
        voltages(np.ones(5), np.ones(1))
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(rg.InputError, match="jax_enable_x64"):
        voltages(np.ones(5))


def test_a_missing_package_is_reported_with_its_installation() -> None:
    program = """
import sys; sys.modules["jax"] = None
import resgrid as rg
try:
    rg.circuit.jax_solver(rg.Netlist(2, [[0, 1]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0]))
except rg.ToolMissingError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120)
    assert "differentiable solvers need the package jax" in done.stdout and "pip install" in done.stdout
