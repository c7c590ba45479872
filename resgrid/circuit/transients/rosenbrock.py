"""One step of the Rosenbrock method RODAS for the equations of a circuit with memristors.

RODAS (Hairer & Wanner, *Solving Ordinary Differential Equations II*, 1996, section VI.4) has six stages and order 4,
with an embedded solution of order 3.  It is L-stable and stiffly accurate, and applies to differential-algebraic
equations of index 1, such as circuits with nodes without capacitance.
"""

from __future__ import annotations

import numpy as np

from resgrid.circuit.transients.memristive_equations import MemristiveEquations, Point, StepMatrix
from resgrid.circuit.transients.stamps import Vector
from resgrid.circuit.transients.waveforms import Drive

GAMMA = 0.25
ORDER = 4
_TIMES = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)
"""Time of every stage, as a fraction of the step."""

_SLOPES = (0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0)
"""Coefficient of the time derivative of the right-hand sides, times the length of the step, in every stage."""

_POINTS = np.array(
    (
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (1.544, 0.0, 0.0, 0.0, 0.0),
        (0.9466785280815826, 0.2557011698983284, 0.0, 0.0, 0.0),
        (3.314825187068521, 2.896124015972201, 0.9986419139977817, 0.0, 0.0),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 0.0),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
    )
)
"""Coefficients of the solutions of earlier stages in the point of a stage, shape (stage, earlier stage).

The right-hand sides of a stage are evaluated at this point.
"""

_RIGHT = np.array(
    (
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (-5.6688, 0.0, 0.0, 0.0, 0.0),
        (-2.430093356833875, -0.2063599157091915, 0.0, 0.0, 0.0),
        (-0.1073529058151375, -9.594562251023355, -20.47028614809616, 0.0, 0.0),
        (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160, 0.0),
        (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
    )
)
"""Coefficients of the solutions of earlier stages in the right-hand side of a stage, shape (stage, earlier stage).

They are multiplied by ``M / h``, with the matrix ``M`` of the time derivatives and the length ``h`` of the step.
"""


def advance(equations: MemristiveEquations, at: Point, h: float, first: Drive, moving: Vector) -> tuple[Point, Point]:
    """Return the point after a step, and its estimated error.

    `equations`: the equations; `at`: the unknowns before the step; `h`: length of the step, in seconds; `first`:
    waveform of the sources at the beginning of the step, linear within the step; `moving` (m,): 1 for a memristor whose
    state can change, 0 for one that rests at a limit.
    """
    matrix = StepMatrix.at(equations, at, first, moving, 1 / (GAMMA * h))
    begin, by_time = at.joined(), equations.time_derivative(at, first, moving).joined()
    farads, capacitors, rows = equations.circuit.netlist.capacitance, equations.capacitors, len(at.voltage)
    stages = np.empty((len(_TIMES), len(begin)))
    point = begin
    for i, (part, slope) in enumerate(zip(_TIMES, _SLOPES, strict=True)):
        point = begin + _POINTS[i, :i] @ stages[:i]
        drive = Drive(first.value + part * h * first.slope, first.slope)
        right = equations.slope(at.like(point), drive, moving).joined() + slope * h * by_time
        coupled = (_RIGHT[i, :i] / h) @ stages[:i]
        coupled[:rows] = capacitors.out_of(farads * capacitors.across(coupled[:rows]))
        stages[i] = matrix.solved(at.like(right + coupled)).joined()
    return at.like(point + stages[-1]), at.like(stages[-1])
