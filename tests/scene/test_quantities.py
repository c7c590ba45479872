"""Numbers with engineering suffixes: parsed and formatted values compared with literals.

Tests internals: `resgrid.scene.quantities`.
"""

import pytest
from hypothesis import given, strategies as st

import resgrid as rg
from resgrid.scene.quantities import format_quantity, parse_quantity


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("10k", 10e3),
        ("4k7", 4.7e3),
        ("2.2meg", 2.2e6),
        ("1M", 1e6),
        ("2M2", 2.2e6),
        ("100n", 100e-9),
        ("1u", 1e-6),
        ("1µ", 1e-6),
        ("3.3", 3.3),
        ("3m", 3e-3),
        ("1e4", 1e4),
        ("-5", -5.0),
        (".5k", 500.0),
        (7, 7.0),
        (0.25, 0.25),
    ],
)
def test_engineering_suffixes_are_parsed(text, value):
    assert parse_quantity(text) == value


@pytest.mark.parametrize(
    "text",
    [
        "",
        "k",
        "10K",
        "10kohm",
        "10 k",
        " 10k",
        "4k7k",
        "4.0k7",
        "1e3k",
        "1_000",
        "0x10",
        "nan",
        "inf",
        "1e999",
        "10Meg",
        "٣k",
        True,
        None,
        [1],
        float("nan"),
        float("inf"),
        10**400,
        "1" * 100,
    ],
)
def test_invalid_quantities_raise_input_error_with_an_example(text):
    with pytest.raises(rg.InputError, match="4k7"):
        parse_quantity(text)


@given(st.integers(0, 9999), st.integers(0, 999))
def test_a_suffix_in_the_middle_is_the_decimal_point(whole, part):
    assert parse_quantity(f"{whole}k{part}") == float(f"{whole}.{part}e3")


def test_percentages_are_parsed_and_values_formatted_with_prefixes():
    assert [rg.Chip(mismatch=share).mismatch for share in ("10 %", "2.5%", 0.1)] == [0.1, 0.025, 0.1]
    values = (38.123e-6, "A", 3), (10e3, "Ω"), (4700.0,)
    assert [format_quantity(*value) for value in values] == ["38.1 µA", "10 kΩ", "4.7k"]
