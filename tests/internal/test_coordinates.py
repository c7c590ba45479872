"""Coordinates as text: enough digits far from the origin, and no more digits than necessary near it.

Tests internals: `resgrid._internal.coordinates`.
"""

import pytest

from resgrid._internal.coordinates import coordinate_text


@pytest.mark.parametrize(
    ("value", "step", "text"),
    [
        (0.0, 1e-3, "0"),
        (-2.5, 1e-3, "-2.5"),
        (1 / 3, 1e-3, "0.333333"),
        (123.4567891, 1e-3, "123.457"),
        (-5399960.3628518, 1e-3, "-5399960.363"),
        (500040.0457621859, 1e-5, "500040.04576"),
        (1e30 / 3, 1e-3, "3.33333333333333e+29"),
        (float("inf"), 1e-3, "inf"),
    ],
)
def test_coordinates_resolve_the_step(value, step, text):
    assert coordinate_text(value, step) == text
