"""Names, marks and files that simulators read otherwise than as written, compared with ngspice runs.

Tests internals: `resgrid.spice.run.ngspice`.
"""

from __future__ import annotations

import io
from pathlib import Path

import pytest

import resgrid as rg
from resgrid.spice.run.ngspice import simulate

HEAD = "title\nV1 in 0 1\n"
TAIL = "\nR2 a 0 1k\n.op\n.end\n"
MODEL = ".model rm r r=3k\n"
CELL = ".subckt s p q r=2k\nR1 p q {r}\n.ends\n"

REJECTED = {
    "model and parameter": (".param rm=2k\n" + MODEL + "R1 in a rm", ":5:9: ngspice takes rm for the parameter"),
    "model after a value": (".param rm=2k\n" + MODEL + "R1 in a 5k rm", ":5:12: ngspice takes rm for the parameter"),
    "model and argument": (".subckt s p q RM=2k\n" + MODEL + "R1 p q rm\n.ends\nX1 in a s", ":5:8: ngspice takes rm"),
    "a model called like a key": (
        ".model m r r=3k\nR1 in a m\nR3 in a 500 m=2",
        ":5:13: ngspice takes m for the model of this name",
    ),
    "a model called m and a multiplier": (".model m r r=3k\n" + CELL + "X1 in a s m=2", ":7:11: in ngspice this m= is"),
    "a model called like a number": (".model 1k r r=3k\nR1 in a 1k", ":4:9: ngspice takes 1k for a number"),
    "a comma after the subcircuit": (CELL + "X1 in a s ,r=3k", ":6:9: ngspice misreads a comma"),
    "a comma before the subcircuit": (CELL + "X1 in a,s", ":6:9: ngspice misreads a comma"),
    "a form feed": ("R1 in a 1k\n \fR3 a 0 1k", ":4:2: a form feed or vertical tab begins this line"),
    "an open parenthesis": ("R1 in a 1k\nR3 (a 0 1k", ":4:4: the parentheses around the nodes do not match"),
}
READ = {
    "subcircuit and parameter": (".param s=2k\n" + CELL + "X1 in a s", "finds no subcircuit"),
    "a parameter called dc": (".param dc=5\nV2 b 0 dc 1\nR1 b a 1k", "takes dc for the parameter"),
    "a name after a parenthesis": (".param v=1\nV2 b 0 pulse(v 5 0 1n 1n 1u 2u)\nR1 b a 1k", "directly after pulse("),
    "temperature without braces": (".param p='10*temper'\nR1 in a p", "without braces: write {p}"),
}
EQUAL = {
    "a parameter of another subcircuit": (
        ".subckt s p q rm=2k\nR1 p q {rm}\n.ends\n" + MODEL + "R1 in a rm\nX1 a 0 s", 1.0 / (1.0 + 3.0 * (1 + 0.5))
    ),
    "a key that is no model's name": (".model m r r=3k\nR1 in a m\nR3 in a 500 tc1=1 m=2", 1 / (1 + 3 / 13)),
    "a form feed alone": ("\f\nR1 in a 1k", 0.5),
    "commas between nodes": (CELL + "X1 in, a s r=1k", 0.5),
    "blanks after a parenthesis": (".param v=1\nV2 b 0 pulse( v 5 0 1n 1n 1u 2u)\nR1 b a 1k", 0.5),
}  # fmt: skip


def read(text: str, dialect: str = "ngspice") -> rg.spice.Circuit:
    return rg.read_spice(io.StringIO(text), dialect=dialect)


def voltage(deck: rg.spice.Circuit) -> float:
    return float(rg.solve(deck).voltage[deck.node_names.index("a")])


def ngspice_voltage(text: str) -> float | None:
    return simulate(text.encode(), direct=True).voltage.get("a")


@pytest.mark.parametrize("lines", REJECTED)
def test_text_that_ngspice_misreads_is_rejected_at_its_place(lines: str) -> None:
    text, message = REJECTED[lines]
    with pytest.raises(rg.InputError) as caught:
        read(HEAD + text + TAIL)
    assert message in str(caught.value)


@pytest.mark.parametrize("lines", READ)
def test_text_at_which_ngspice_stops_is_a_predicted_failure(lines: str) -> None:
    text, message = READ[lines]
    deck = read(HEAD + text + TAIL)
    assert any(message in note.text for note in deck.notes)
    outcomes = {prediction.simulator: prediction.outcome for prediction in rg.spice.check_portability(deck)}
    assert outcomes["ngspice"] == "fails"
    assert ngspice_voltage(HEAD + text + TAIL) is None


@pytest.mark.parametrize("lines", EQUAL)
def test_similar_text_has_the_value_of_ngspice(lines: str) -> None:
    text, expected = EQUAL[lines]
    assert voltage(read(HEAD + text + TAIL)) == pytest.approx(expected, rel=1e-9)
    assert ngspice_voltage(HEAD + text + TAIL) == pytest.approx(expected, rel=1e-6)


def test_parameters_of_higher_levels_are_rejected_in_hspice() -> None:
    text = HEAD + ".param r=5k\n" + CELL + "X1 in a s r=3k" + TAIL
    with pytest.raises(rg.InputError, match=r":7: HSPICE takes the r of the higher level \(5000\)"):
        read(text, "hspice")
    assert voltage(read(text.replace("R2", ".option parhier=local\nR2"), "hspice")) == pytest.approx(0.25)
    assert voltage(read(text.replace("r=3k", "r=r"), "hspice")) == pytest.approx(1 / 6)
    assert voltage(read(text)) == pytest.approx(0.25)
    nested = ".subckt t p q r=4k\nX1 p q s r=1k\n.ends\n"
    with pytest.raises(rg.InputError, match=r"the r of the higher level \(4000\)"):
        read(HEAD + CELL + nested + "X1 in a t" + TAIL, "hspice")


def test_an_include_file_in_two_folders_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    deck = tmp_path / "deck.cir"
    deck.write_text(HEAD + ".include inner/first.inc" + TAIL)
    (tmp_path / "inner" / "first.inc").write_text(".include second.inc\n")
    (tmp_path / "inner" / "second.inc").write_text("R1 in a 3k\n")
    assert voltage(rg.read_spice(deck)) == pytest.approx(0.25)
    (tmp_path / "second.inc").write_text("R1 in a 3k\n")
    assert voltage(rg.read_spice(deck)) == pytest.approx(0.25)
    (tmp_path / "second.inc").write_text("R1 in a 1k\n")
    with pytest.raises(rg.InputError, match=r"first\.inc:1:1: 'second\.inc' exists in"):
        rg.read_spice(deck)
    (tmp_path / "inner" / "first.inc").write_text(".include inner/second.inc\n")
    assert voltage(rg.read_spice(deck)) == pytest.approx(0.25)


def test_only_the_first_of_two_sections_is_read_in_ngspice(tmp_path: Path) -> None:
    deck = tmp_path / "deck.cir"
    deck.write_text(HEAD + ".lib a.lib tt\nR1 in a {p}" + TAIL)
    (tmp_path / "a.lib").write_text(".lib tt\n.param p=3k\n.endl\n.lib tt\n.param p=1k\n.endl\n")
    circuit = rg.read_spice(deck)
    assert voltage(circuit) == pytest.approx(0.25)
    assert any("the section tt is defined again" in note.text for note in circuit.notes)
    assert rg.check_deck(deck).agrees


@pytest.mark.parametrize(
    ("request_line", "content", "message"),
    [
        (".lib a.lib", "R1 in a 1k\n", "stops at .lib without the name of a section"),
        (".lib a.lib tt", ".lib tt\nR1 in a 1k\n", "stops at .lib tt without .endl"),
        (".include a.lib", "\N{ZERO WIDTH NO-BREAK SPACE}R1 in a 1k\n", "a byte order mark"),
    ],
)
def test_libraries_at_which_ngspice_stops(tmp_path: Path, request_line: str, content: str, message: str) -> None:
    (tmp_path / "deck.cir").write_text(HEAD + request_line + TAIL)
    (tmp_path / "a.lib").write_text(content, encoding="utf-8")
    deck = rg.read_spice(tmp_path / "deck.cir")
    assert voltage(deck) == pytest.approx(0.5)
    assert [message in note.text for note in deck.notes if note.severity == "warning"] == [True]
    assert next(iter(rg.spice.check_portability(deck))).outcome == "fails"
