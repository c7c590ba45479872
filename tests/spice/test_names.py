from __future__ import annotations

import re

from hypothesis import given, strategies as st

from resgrid.spice.write.names import legal_names


@given(st.lists(st.text(max_size=6) | st.sampled_from(["a", "A", "a_2", "gnd", "GND", "0", ""])))
def test_names_are_legal_unique_and_stable(wanted: list[str]) -> None:
    names = legal_names(wanted, "n", ["gnd"])
    assert len(names) == len(wanted) == len(set(names))
    assert all(re.fullmatch("[a-z][a-z0-9_]*", name) and name != "gnd" for name in names)
    for name in set(wanted):
        if re.fullmatch("[a-z][a-z0-9_]*", name) and name != "gnd":
            assert names[wanted.index(name)] == name
    assert legal_names(names, "n", ["gnd"]) == names


def test_many_equal_names_are_numbered_fast() -> None:
    names = legal_names(["a"] * 50_000, "n")
    assert names[:3] == ["a", "a_2", "a_3"]
    assert len(set(names)) == 50_000


def test_a_legal_name_keeps_its_place_before_a_mapped_one() -> None:
    assert legal_names(["N1", "n1", "n1"], "n") == ["n1_2", "n1", "n1_3"]
