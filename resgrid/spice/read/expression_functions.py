"""Functions that expressions in decks may call, by resgrid's names; each dialect maps its own names to these names."""

from __future__ import annotations

import math
from collections.abc import Callable

_OF_MATH = "sqrt exp log10 floor ceil sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
_ONE_ARGUMENT: dict[str, Callable[[float], float]] = {
    **{name: getattr(math, name) for name in _OF_MATH.split()},
    "ln": math.log,
    "abs": abs,
    "int": math.trunc,
    "nint": round,
    "sgn": lambda x: (x > 0) - (x < 0),
    "step": lambda x: x > 0,
    "step_half": lambda x: x > 0.5,
    "ramp": lambda x: max(x, 0.0),
}
_TWO_ARGUMENTS: dict[str, Callable[[float, float], float]] = {
    "min": min,
    "max": max,
    "atan2": math.atan2,
    "hypot": math.hypot,
    "pow": math.pow,
    "pow_integer": lambda x, y: math.pow(x, math.trunc(y)),
    "pwr": lambda x, y: math.pow(abs(x), y),
    "pwr_signed": lambda x, y: math.copysign(math.pow(abs(x), y), x),
}
FUNCTIONS: dict[str, tuple[int, Callable[..., float]]] = {
    **{name: (1, function) for name, function in _ONE_ARGUMENT.items()},
    **{name: (2, function) for name, function in _TWO_ARGUMENTS.items()},
    "if": (3, lambda condition, this, that: this if condition else that),
    "if_half": (3, lambda condition, this, that: this if condition > 0.5 else that),
    "limit": (3, lambda x, low, high: min(max(x, min(low, high)), max(low, high))),
}
"""Number of arguments and implementation of every function in expressions, by resgrid's name of the function."""


def shown_call(name: str, values: list[float]) -> str:
    """Return the name of a called function, with arguments that some dialects do not support.

    Examples: "min of three arguments", "pow of a negative number", "sin".  `values`: values of the arguments.
    """
    if name in ("min", "max") and len(values) == 3:
        return f"{name} of three arguments"
    return f"{name} of a negative number" if name in ("pow", "pwr") and values and values[0] < 0 else name
