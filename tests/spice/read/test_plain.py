"""The fast reader of plain cards, compared with Python's float and with the general reader.

Tests internals: `resgrid.spice.dialects`, `resgrid.spice.read.deck`, `resgrid.spice.read.element_tables`,
`resgrid.spice.read.files`, `resgrid.spice.read.plain_cards`.
"""

import random
import struct
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.decks import outcome, same

from resgrid.spice.dialects import DIALECTS
from resgrid.spice.read.deck import read_with
from resgrid.spice.read.element_tables import Elements, NodeTable
from resgrid.spice.read.files import SourceFile
from resgrid.spice.read.plain_cards import PlainCards

floats = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(0, 2**64 - 1).map(lambda bits: struct.unpack("<d", bits.to_bytes(8, "little"))[0]),
).filter(lambda x: np.isfinite(x) and x != 0)


def read_plain_resistors(text: str) -> tuple[list[str], list[float]]:
    """Return names and values of the plain resistors in a text."""
    cards = PlainCards(SourceFile(0, "deck", None, text.encode()), 0, DIALECTS["ngspice"].reading)
    elements = Elements(NodeTable(frozenset({"0"})), 27.0)
    elements.nodes.number_of("0", 0)
    for _ in cards.other_lines(lambda: True):
        pass
    cards.add_to(elements)
    found = elements.joined("resistor")
    return found.names(), found.values[:, 0].tolist()


spellings = st.sampled_from(("%r", "%.17g", "%.3e", "%.20f", "%.25e", "%g", "%.16e"))


@given(st.lists(st.tuples(floats, spellings), min_size=1, max_size=50))
def test_numbers_are_read_as_the_nearest_doubles(wanted: list[tuple[float, str]]) -> None:
    words = [spelling % value for value, spelling in wanted]
    kept = dict(zip(*read_plain_resistors("".join(f"R{i} a b {word}\n" for i, word in enumerate(words))), strict=True))
    for i, word in enumerate(words):
        if f"R{i}" in kept:
            assert kept[f"R{i}"] == float(word), word
        else:
            assert float(word) == 0 or len(word) > 300 or "e" in word


def test_halfway_cases_round_to_even() -> None:
    pick = random.Random(1)
    words = [str(2**53 + 1), str(2**54 + 2), "9007199254740993e0", "1e23", "8.5e22", "5e-324", "1.7976931348623157e308"]
    for _ in range(2000):
        mantissa = pick.randrange(2**52, 2**53)
        words.append(f"{2 * mantissa + 1}e{pick.randrange(-20, 20)}")
        words.append(repr(pick.uniform(0, 1) * 10.0 ** pick.randrange(-60, 60)))
    _, found = read_plain_resistors("".join(f"R{i} a b {word}\n" for i, word in enumerate(words)))
    assert found == [float(word) for word in words]


CARDS = st.sampled_from(
    (
        *(
            "R1 a b 1",
            "b1 a b i=1m*tanh(v(a,b)/0.1)",
            "r2 B c 2.5e3",
            "R3 c 0 R=7",
            "R4 c gnd 1k",
            "V1 a 0 1",
            "V2 d 0 DC 2",
            "I1 a 0 dc 1m",
            "C1 a b 1p",
        ),
        *(
            "R5 a b 1 ; x",
            "R6 a b {1+1}",
            "R7 a b 1 tc1=1",
            "+ m=2",
            "* comment",
            "",
            "  R8  a\tb 5  ",
            "R9 a/b c//d 1",
        ),
        *("R10 a b 1e999", "R11 a b -0", "R12 a b 1M", "C2 a b -1", ".param x=1", "R13 a b x", "L1 d e 1", "x1 a b s"),
        *(
            ".subckt s p q\nR1 p q 1\n.ends",
            ".subckt s p\n; of the subcircuit\n+ q\nR1 p q 1\n.ends",
            ".subckt s \\\\ \n\np q\nR1 p q 1\nR2 q p 1\n.ends",
            ".subckt s p q\n.param r=1\nR1 p q {r}\nR2 p q 1\n.ends\nR30 p q 1",
            ".control\nR1 q q 1\n.endc",
            "+",
            "R14 a b 5\n* no\n\n+ m=3",
            ".end",
            "R15 a b 1\\\\",
            "\\\\",
        ),
        *(
            "R16 a$b c 1",
            "R17 (a b) 1",
            "R18 a,b 1",
            "R19 A B 1",
            "R20 a b 0",
            "v5 e 0 0",
            "I7 0 a 1.5.2",
            ".if 1",
            "R21 a b 1e",
            "R25 a b 1e+",
            "R26 a b .5e",
            "V7 a b dc",
            "R27 a/b c/ 1",
            "R22 a b 1e000000001",
            "R23 a b 1e0000000001",
            "R24 a b DC 1m",
            "V6 f 0 R=1",
            "C3 a b DC 1",
            "i8 0 a dc 1",
            "c4 a b c=1p",
        ),
    )
)


@pytest.mark.slow
@given(st.sampled_from(("title", "R0 a b 1", ".param y=2", "* t")), st.lists(CARDS, max_size=12))
@settings(max_examples=300)
def test_the_fast_reader_agrees_with_the_general_reader(tmp_path_factory, first: str, cards: list[str]) -> None:
    path = tmp_path_factory.mktemp("deck") / "deck.cir"
    path.write_text("\n".join([first, *cards]))
    assert same(outcome(path, 10**9), outcome(path, 0))


@pytest.mark.parametrize("count", [1000, 4000])
def test_large_decks_are_read_completely(tmp_path, count: int) -> None:
    path = tmp_path / "deck.cir"
    chain = "".join(f"R{i} n{i} N{i + 1} {1.0 + i / 7!r}\n" for i in range(count))
    path.write_text(f"chain\nV1 n0 0 1\n{chain}Rend n{count} 0 1k\n.end\n")
    deck = read_with(path, least_bytes=0)
    assert deck.resistance.tolist() == [1.0 + i / 7 for i in range(count)] + [1000.0]
    assert deck.node_names == ("0", *(f"n{i}" if i == 0 else f"N{i}" for i in range(count)), f"N{count}")


def test_reading_and_checking_a_large_deck_do_not_import_numba(tmp_path) -> None:
    path = tmp_path / "deck.cir"
    chain = "".join(f"R{i} n{i} n{i + 1} {i + 1}k\n" for i in range(4000))
    path.write_text(f"chain\nV1 n0 0 1\n{chain}Rend n4000 0 1k\n.end\n")
    code = (
        "import sys, resgrid as rg\n"
        "assert not rg.check_erc(rg.read_spice(sys.argv[1]))\n"
        "assert not any(name.partition('.')[0] in ('numba', 'llvmlite') for name in sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=True, timeout=120)


@pytest.mark.parametrize("card", ["R2 a b DC 1", "V2 a b R=1", "I2 a b R=1", "C2 a b DC 1", "C2 a b R=1"])
def test_cards_with_keys_of_another_element_agree_with_the_general_reader(tmp_path, card: str) -> None:
    path = tmp_path / "deck.cir"
    path.write_text(f"title\nV1 a 0 1\nR1 a b 1\n{card}\nR3 b 0 2\n")
    assert same(outcome(path, 10**9), outcome(path, 0))


def test_a_first_line_joined_with_a_plain_card_is_read_alike(tmp_path) -> None:
    path = tmp_path / "deck.cir"
    path.write_text("R15 a b 1\\\\\nR0 a b 1\n  {{R8 a b 5\n")
    assert same(outcome(path, 10**9), outcome(path, 0))


def test_node_names_have_the_spelling_of_their_first_occurrence(tmp_path) -> None:
    path = tmp_path / "deck.cir"
    path.write_text("title\nR1 a4 0 {1}\nR2 (A4 0) 2\nI1 a4 0 0.7M\nV1 x A4 1\n")
    for least_bytes in (0, 10**9):
        assert read_with(path, least_bytes=least_bytes).node_names == ("0", "a4", "x")


def test_included_files_agree_with_the_general_reader(tmp_path) -> None:
    path = tmp_path / "deck.cir"
    path.write_text("title\nV1 a 0 1\n.include more.inc\nR1 a 0 1\n.include more.inc\nR2 a b 2\n")
    (tmp_path / "more.inc").write_text("R3 a B 1M\n+ m=2\nR4 b 0 5M\n.subckt s p q\nR1 p q 1\n.ends\nR5 b 0 1k\n")
    assert same(outcome(path, 10**9), outcome(path, 0))
    path.write_text(path.read_text().replace("R1 a 0 1\n.include more.inc\n", ""))
    assert same(outcome(path, 10**9), outcome(path, 0))
    assert sorted(read_with(path, least_bytes=0).resistance.tolist()) == [5e-4, 5e-3, 2.0, 1e3]
