"""Text in bulk: numbers as repr prints them, rows put together from columns."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from resgrid.spice.text.texts import fill, names, numbers, weave

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(FINITE, min_size=1, max_size=50))
def test_a_number_is_written_as_repr_does(values: list[float]) -> None:
    assert numbers(np.array(values)).strings() == [repr(value) for value in values]


def test_every_kind_of_double_is_written_as_repr_does() -> None:
    rng = np.random.default_rng(0)
    any_bits = rng.integers(0, 2**64, 200_000, dtype=np.uint64).view(np.float64)
    values = np.concatenate(
        [
            any_bits[np.isfinite(any_bits)],
            2.0 ** np.arange(-1074, 1024),
            10.0 ** np.arange(-323, 309),
            np.nextafter(10.0 ** np.arange(-300, 300), np.inf),
            rng.integers(-(2**60), 2**60, 20_000).astype(np.float64),
            np.round(rng.uniform(0, 1e6, 50_000), 3),
            [0.0, -0.0, 5e-324, 1.7976931348623157e308, 2.2250738585072014e-308, 9007199254740993.0, 1e16, 1e-4, 1e-5],
        ]
    )
    wrong = [
        (got, want)
        for got, want in zip(numbers(values).strings(), map(repr, values.tolist()), strict=True)
        if got != want
    ]
    assert wrong == []


def test_rows_are_put_together_from_columns() -> None:
    words = names(["", "a", "bcd"])
    chosen = words.take(np.array([2, 0, 1, 1]))
    assert weave(4, b"<", chosen, b">").strings() == ["<bcd>", "<>", "<a>", "<a>"]
    lines = fill("{name} {{x}} {value}\n", 2, {"name": names(["r", "s"]), "value": numbers(np.array([1.0, 2.5]))})
    assert lines.decode() == "r {x} 1.0\ns {x} 2.5\n"
    assert weave(0, b"x", names([])).decode() == ""
