"""Where a deck is wrong: its own elements, held against the voltages that it should have."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.dialects import dialect_named
from resgrid.spice.write.expected import Expected

_MAX_FINDINGS = 5
_ROUNDING = 64 * np.finfo(np.float64).eps
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?"
_ELEMENT = re.compile(
    rf"(?P<name>[rvic][a-z0-9_]*) (?P<first>[a-z0-9_]+) (?P<second>[a-z0-9_]+) (?P<value>{_NUMBER})"
    rf"(?: tc1={_NUMBER} tc2={_NUMBER})?"
)
_NONLINEAR = re.compile(
    rf"b[a-z0-9_]* (?P<first>[a-z0-9_]+) (?P<second>[a-z0-9_]+) "
    rf"i=(?P<value>{_NUMBER})\*tanh\(v\((?P=first),(?P=second)\)/(?P<volts>{_NUMBER})\)"
)
_OPTIONS = dialect_named("ngspice").precise
_GROUND = "0"


@dataclass(frozen=True, eq=False)
class _Elements:
    """What a flat deck holds, lines counted from 1; ``ends`` are positions in ``nodes``, ground is 0.

    ``volts`` is ``V0`` of nonlinear resistors, 1 elsewhere.
    """

    nodes: list[str]
    kind: NDArray[np.str_]
    ends: NDArray[np.int64]
    value: NDArray[np.float64]
    volts: NDArray[np.float64]
    line: NDArray[np.int64]


def inspect_deck(data: bytes, expected: Expected, tolerance: float) -> list[str]:
    """Say where a flat deck contradicts the voltages that are expected of it.

    Kirchhoff's current law is evaluated at every node with the deck's own values and the expected voltages; this sees
    a changed element even where the voltages hardly move.
    """
    elements, problems = _parse(data, expected.voltage)
    if elements is None:
        return problems
    voltage = np.array([0.0, *(expected.voltage[name] for name in elements.nodes[1:])])
    return [
        *problems,
        *_wrong_sources(elements, voltage, expected.supply * tolerance),
        *_wrong_nodes(elements, voltage, max(tolerance, 4 * expected.kcl_residual)),
    ][:_MAX_FINDINGS]


def _parse(data: bytes, known: Mapping[str, float]) -> tuple[_Elements | None, list[str]]:
    number = {_GROUND: 0, **{name: i for i, name in enumerate(known, start=1)}}
    rows: list[tuple[str, int, int, float, float, int]] = []
    problems: list[str] = []
    for line, text in enumerate(data.decode("utf-8", "replace").split("\n"), start=1):
        if not text or text.startswith("* ") or text in (".end", _OPTIONS):
            continue
        match = _ELEMENT.fullmatch(text) or _NONLINEAR.fullmatch(text)
        if match is None:
            problems.append(f"line {line} is none that resgrid writes: {text[:80]!r}")
        elif match["first"] not in number or match["second"] not in number:
            stranger = match["first"] if match["first"] not in number else match["second"]
            problems.append(f"line {line} names the node {stranger}, which is not expected: {text[:80]!r}")
        else:
            value, volts = float(match["value"]), float(match["volts"]) if text[0] == "b" else 1.0
            if not math.isfinite(value) or (text[0] in "rb" and min(value, volts) <= 0):
                problems.append(f"line {line} has a value out of range: {text[:80]!r}")
            else:
                rows.append((text[0], number[match["first"]], number[match["second"]], value, volts, line))
    if not rows:
        return None, (problems or ["the deck holds no element"])[:_MAX_FINDINGS]
    kind, first, second, value_, volts_, line_ = zip(*rows, strict=True)
    elements = _Elements(
        list(number),
        np.array(kind),
        np.array([first, second]).T,
        np.array(value_),
        np.array(volts_),
        np.array(line_, dtype=np.int64),
    )
    return elements, problems


def _wrong_sources(elements: _Elements, voltage: NDArray[np.float64], allowed: float) -> list[str]:
    chosen = elements.kind == "v"
    plus, minus = voltage[elements.ends[chosen]].T
    error = np.abs(plus - minus - elements.value[chosen])
    return [
        f"line {elements.line[chosen][i]}: the source sets {elements.value[chosen][i]:g} V, "
        f"but {plus[i] - minus[i]:g} V is expected"
        for i in np.argsort(-error, kind="stable").tolist()
        if error[i] > allowed
    ]


def _wrong_nodes(elements: _Elements, voltage: NDArray[np.float64], tolerance: float) -> list[str]:
    count = len(elements.nodes)
    net, through, noise = np.zeros(count), np.zeros(count), np.zeros(count)
    current, rounding = _currents(elements, voltage)
    for column, sign in ((0, 1.0), (1, -1.0)):
        nodes = elements.ends[:, column]
        net += np.bincount(nodes, sign * current, count)
        through += np.bincount(nodes, np.abs(current), count)
        noise += np.bincount(nodes, rounding, count)
    free = np.ones(count, dtype=np.bool_)
    free[0] = False
    free[elements.ends[elements.kind == "v"].ravel()] = False
    allowed = tolerance * through + noise
    excess = np.where(free, np.abs(net), 0.0) / np.where(allowed > 0, allowed, 1.0)
    findings = [
        f"at node {elements.nodes[node]} the currents do not add up: {abs(net[node]):.3g} A is left over "
        f"({_lines_at(elements, node)})"
        for node in np.argsort(-excess, kind="stable")[:_MAX_FINDINGS].tolist()
        if excess[node] > 1
    ]
    touched = np.bincount(elements.ends.ravel(), minlength=count) > 0
    lost = np.flatnonzero(~touched[1:]) + 1
    return [*(f"node {elements.nodes[node]} has no element" for node in lost[:_MAX_FINDINGS].tolist()), *findings]


def _currents(elements: _Elements, voltage: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Current from the first node to the second, and what rounding of the voltages may change in it."""
    first, second = voltage[elements.ends].T
    is_resistor, is_current = elements.kind == "r", elements.kind == "i"
    conductance = np.where(is_resistor, 1 / np.where(is_resistor, elements.value, 1.0), 0.0)
    current = conductance * (first - second) + np.where(is_current, elements.value, 0.0)
    is_nonlinear = elements.kind == "b"
    current += np.where(is_nonlinear, elements.value * np.tanh((first - second) / elements.volts), 0.0)
    steepest = conductance + np.where(is_nonlinear, elements.value / elements.volts, 0.0)
    return current, _ROUNDING * steepest * (np.abs(first) + np.abs(second))


def _lines_at(elements: _Elements, node: int) -> str:
    lines = elements.line[(elements.ends == node).any(axis=1)]
    shown = ", ".join(str(line) for line in lines[:_MAX_FINDINGS].tolist())
    return f"lines {shown}" + (" and more" if len(lines) > _MAX_FINDINGS else "")
