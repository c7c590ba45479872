"""Compiled kernels for a space of two axes with changed cells: equations, face currents, check of Kirchhoff's law.

Import this module only inside functions that call a kernel, because importing numba takes seconds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, kernel
from resgrid.solvers.scaled_kernels import _LOG_BASE, NO_EXPONENT, _shift

_HIGH, _LOW = 1, 2  # `resgrid.core.compiler.CellRole`

_NOISE = 1e-12
"""Bound on the relative error of the value (drop or height) of a cell.

A smaller relative difference of the values of two cells may be a rounding error.
"""

_NEGLIGIBLE = 1e-7
"""Largest fraction of a cell's through-current at which a current that may be a rounding error is set to zero.

The current must be at most this fraction in both cells of the face.
"""

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Values(NamedTuple):
    """Value of every cell of a plane: the smaller one of its height above the low rail and its drop from the high rail.

    All arrays have a margin of one cell, (nx + 2, ny + 2).  `own`: whether a cell has an equation; `mantissa`,
    `exponent`: value ``mantissa * 2**(256 exponent)`` as a fraction of the supply, or with a single rail, of the
    largest height; `is_drop`: whether the value is a drop.
    """

    own: Bools
    mantissa: Floats
    exponent: Integers
    is_drop: Bools


@kernel
def split_contacts(
    kind: NDArray[np.uint8], own: Bools, faces: tuple[Floats, Floats], unit: float, inner: tuple[Floats, Floats],
    low: Floats, high: Floats,
) -> None:  # fmt: skip
    """Split the conductances of a plane's faces into those between cells with an equation, and those to the rails.

    `kind` (nx + 2, ny + 2): `CellRole` of every cell, with a margin; `own` (nx, ny): whether a cell has an equation;
    `faces`: conductances (nx + 1, ny) and (nx, ny + 1) of the faces across both axes, in siemens, which are multiplied
    by `unit`, the resistance between neighbours.  Results, in units of 1 / resistance: `inner`, shapes of `faces`:
    conductances between cells with an equation, 0 at other faces; `low`, `high` (nx, ny): conductance of every cell to
    the low and to the high rail.
    """
    low[:], high[:], inner[0][:], inner[1][:] = 0.0, 0.0, 0.0, 0.0
    for i in range(own.shape[0]):
        for j in range(own.shape[1]):
            if not own[i, j]:
                continue
            for side in range(4):
                up, across = side % 2, side < 2
                x, y = i + (2 * up - 1) * across, j + (2 * up - 1) * (not across)
                g = unit * (faces[0][i + up, j] if across else faces[1][i, j + up])
                if g == 0.0:
                    continue
                role = kind[x + 1, y + 1]
                if role == _LOW:
                    low[i, j] += g
                elif role == _HIGH:
                    high[i, j] += g
                elif across:
                    inner[0][i + up, j] = g
                else:
                    inner[1][i, j + up] = g


@kernel
def write_values(
    kind: NDArray[np.uint8], own: Bools, drop: tuple[Floats, Integers], height: tuple[Floats, Integers],
    values: Values, potential: Floats, log_drop: Floats,
) -> None:  # fmt: skip
    """Write the values, potentials and logarithms of drops of all cells of a plane between two rails.

    The value of a cell is the smaller one of its drop from the high rail and its height above the low rail, both as
    fractions of the supply.  `kind` (nx + 2, ny + 2): `CellRole` of every cell, with a margin; `own` (nx, ny): whether
    a cell has an equation; `drop`, `height`: mantissas and exponents (nx, ny) of drops and heights,
    ``mantissa * 2**(256 exponent)``.  Results: `values`, arrays with a margin; `potential` (nx, ny): height; `log_drop`
    (nx, ny): natural logarithm of the drop.  Cells without an equation get the values of the low or the high rail.
    """
    values.own[:], values.mantissa[:], values.exponent[:], values.is_drop[:] = False, 0.0, 0, True
    for i in range(own.shape[0]):
        for j in range(own.shape[1]):
            if own[i, j]:
                m, e = drop[0][i, j], drop[1][i, j]
                plain = _shift(m, e)
                is_drop = plain <= 0.5
                if is_drop:
                    potential[i, j], log_drop[i, j] = 1.0 - plain, math.log(m) + e * _LOG_BASE
                else:
                    m, e = height[0][i, j], height[1][i, j]
                    potential[i, j] = _shift(m, e)
                    log_drop[i, j] = math.log1p(-potential[i, j])
                values.own[i + 1, j + 1], values.is_drop[i + 1, j + 1] = True, is_drop
                values.mantissa[i + 1, j + 1], values.exponent[i + 1, j + 1] = m, e
            else:
                at_low = kind[i + 1, j + 1] == _LOW
                values.is_drop[i + 1, j + 1] = not at_low
                potential[i, j], log_drop[i, j] = (0.0, 0.0) if at_low else (1.0, -np.inf)


@kernel
def write_heights(kind: NDArray[np.uint8], own: Bools, height: Floats, values: Values, potential: Floats) -> None:
    """Write the values and potentials of all cells of a plane with a single rail.

    With a single rail, the value and the potential of a cell with an equation are both its height.  On the rail they
    are 0.  In other cells the value is 0 and the potential NaN.  `kind` (nx + 2, ny + 2): `CellRole` of every cell,
    with a margin; `own` (nx, ny): whether a cell has an equation; `height` (nx, ny): height above the rail, as a
    fraction of the largest one.  Results: `values`, arrays with a margin; `potential` (nx, ny): without a unit.
    """
    values.own[:], values.mantissa[:], values.exponent[:], values.is_drop[:] = False, 0.0, 0, False
    for i in range(own.shape[0]):
        for j in range(own.shape[1]):
            if own[i, j]:
                values.own[i + 1, j + 1] = True
                values.mantissa[i + 1, j + 1] = potential[i, j] = height[i, j]
            else:
                potential[i, j] = 0.0 if kind[i + 1, j + 1] == _LOW else np.nan


@inlined
def _fall(values: Values, a: tuple[int, int], b: tuple[int, int]) -> tuple[float, int, bool]:
    """Return the potential of cell `a` minus the potential of `b`, and whether the difference may be a rounding error.

    The difference is ``m * 2**(256 e)``; the results are ``m``, ``e`` and the bool.  `a`, `b`: indices of the cells in
    the arrays of `values`, which have a margin.
    """
    m, e, is_drop = values.mantissa, values.exponent, values.is_drop
    if is_drop[a] != is_drop[b]:
        total = _shift(m[a], e[a]) + _shift(m[b], e[b]) - 1.0
        return -total if is_drop[a] else total, 0, abs(total) <= 0.5 * _NOISE
    top = max(e[a] if m[a] != 0.0 else NO_EXPONENT, e[b] if m[b] != 0.0 else NO_EXPONENT)
    one, other = _shift(m[a], e[a] - top), _shift(m[b], e[b] - top)
    fall = one - other
    return -fall if is_drop[a] else fall, top, abs(fall) <= _NOISE * max(one, other)


@kernel
def face_currents(
    values: Values, conductance: Floats, unit: float, amps: Floats, exponent: Integers, is_uncertain: Bools
) -> None:
    """Compute the current through every face of a plane, positive along the axis, ``amps * 2**(256 exponent)``.

    `values`: values of the cells; `conductance` (faces,): conductances of the faces across the first axis, then across
    the second one, in siemens; `unit`: resistance between neighbours, in ohms.  Results (faces,): `amps`, `exponent` of
    currents in units of supply / resistance (largest height / resistance with a single rail), and `is_uncertain`:
    whether a current may be a rounding error.
    """
    nx, ny = values.own.shape[0] - 2, values.own.shape[1] - 2
    for axis in range(2):
        across = axis == 0
        for i in range(nx + across):
            for j in range(ny + (not across)):
                face = i * ny + j if across else (nx + 1) * ny + i * (ny + 1) + j
                a, b = (i + (not across), j + across), (i + 1, j + 1)
                amps[face], exponent[face], is_uncertain[face] = 0.0, 0, False
                if conductance[face] == 0.0 or not (values.own[a] or values.own[b]):
                    continue
                fall, top, is_uncertain[face] = _fall(values, a, b)
                amps[face], exponent[face] = unit * conductance[face] * fall, top if fall != 0.0 else 0


@kernel
def check_cells(
    values: Values, source: tuple[float, float], amps: Floats, exponent: Integers, through: Floats, scale: Integers
) -> tuple[float, int]:
    """Return the largest violation of KCL relative to the through-current, and the number of cells without outflow.

    Currents are in units of supply / resistance.  `values`: drop or height of the cells; `source`: current into each
    cell with an equation, and conductance of the leak of such a cell to the high rail, in units of 1 / resistance;
    `amps`, `exponent` (faces,): face currents ``amps * 2**(256 exponent)``, positive along the axis.  Results:
    `through`, `scale` (nx, ny): through-currents ``through * 2**(256 scale)``, half the sum of the magnitudes of a
    cell's currents; 0 in cells without an equation.  Cells without any current are skipped.
    """
    nx, ny = through.shape
    own, (injected, leak) = values.own, source
    second = (nx + 1) * ny
    worst, stuck = 0.0, 0
    for i in range(nx):
        for j in range(ny):
            through[i, j], scale[i, j] = 0.0, 0
            if not own[i + 1, j + 1]:
                continue
            lower, upper = (i * ny + j, second + i * (ny + 1) + j), ((i + 1) * ny + j, second + i * (ny + 1) + j + 1)
            top, leaked, at = 0 if injected > 0.0 else NO_EXPONENT, 0.0, 0
            if leak > 0.0:
                leaked, at = values.mantissa[i + 1, j + 1], values.exponent[i + 1, j + 1]
                if not values.is_drop[i + 1, j + 1]:
                    leaked, at = 1.0 - _shift(leaked, at), 0
                leaked *= leak
                top = max(top, at)
            for face in (lower[0], lower[1], upper[0], upper[1]):
                if amps[face] != 0.0:
                    top = max(top, exponent[face])
            if top == NO_EXPONENT:
                continue
            net = injected + _shift(leaked, at - top)
            total, leaves = net, False
            for axis in range(2):
                into = _shift(amps[lower[axis]], exponent[lower[axis]] - top)
                out = _shift(amps[upper[axis]], exponent[upper[axis]] - top)
                net += into - out
                total += abs(into) + abs(out)
                leaves |= into < 0.0 or out > 0.0
            stuck += not leaves
            through[i, j], scale[i, j] = 0.5 * total, top
            worst = max(worst, abs(net) / (0.5 * total))
    return worst, stuck


@kernel
def drop_uncertain(amps: Floats, exponent: Integers, is_uncertain: Bools, through: Floats, scale: Integers) -> int:
    """Set to zero the currents that may be rounding errors and are negligible in both cells; return their number.

    A current is negligible up to the fraction `_NEGLIGIBLE` of a cell's through-current.  `amps, exponent` (faces,):
    currents ``amps * 2**(256 exponent)``, changed in place; `is_uncertain` (faces,): whether they may be rounding
    errors; `through, scale` (nx, ny): through-currents of the cells, 0 in cells without an equation.
    """
    nx, ny = through.shape
    dropped = 0
    for axis in range(2):
        across = axis == 0
        for i in range(nx + across):
            for j in range(ny + (not across)):
                face = i * ny + j if across else (nx + 1) * ny + i * (ny + 1) + j
                if not is_uncertain[face] or amps[face] == 0.0:
                    continue
                is_negligible = True
                for x, y in ((i - across, j - (not across)), (i, j)):
                    if 0 <= x < nx and 0 <= y < ny and through[x, y] > 0.0:
                        size = abs(_shift(amps[face], exponent[face] - scale[x, y]))
                        is_negligible &= size <= _NEGLIGIBLE * through[x, y]
                if is_negligible:
                    amps[face] = 0.0
                    dropped += 1
    return dropped


@kernel
def write_currents(amps: Floats, exponent: Integers, direction: NDArray[np.int8], log_current: Floats) -> None:
    """Write signs and natural logarithms of the magnitudes of currents to `direction` and `log_current`.

    All arrays have the shape (faces,).  `amps`, `exponent`: currents ``amps * 2**(256 exponent)``.  A current of 0 has
    the sign 0 and the logarithm -inf.
    """
    for face in range(len(amps)):
        size = abs(amps[face])
        direction[face] = 0 if size == 0.0 else (1 if amps[face] > 0.0 else -1)
        log_current[face] = -np.inf if size == 0.0 else math.log(size) + exponent[face] * _LOG_BASE
