"""Decks of all dialects: values of ngspice 39, parameters, models, subcircuits, names, titles, encodings and messages.

Tests internals: `resgrid.check_erc`, `resgrid.factorize`, `resgrid.spice.dialects.ngspice`.
"""

import io
import math

import numpy as np
import pytest

import resgrid as rg
from resgrid.spice.dialects.ngspice import ngspice_name


def deck(*lines: str, dialect: str = "ngspice") -> rg.spice.Circuit:
    return rg.read_spice(io.StringIO("\n".join(["title", *lines]) + "\n"), dialect=dialect)


def ohms(card: str, *more: str, dialect: str = "ngspice") -> float:
    """Resistance of R1 at the deck's temperature."""
    found = deck("I1 0 a 1", f"R1 a 0 {card}", *more, dialect=dialect)
    return 1.0 / float(found.netlist().conductance[0])


def rejection(*lines: str, dialect: str = "ngspice") -> str:
    with pytest.raises(rg.InputError) as caught:
        deck(*lines, dialect=dialect)
    return str(caught.value)


# values measured with ngspice 39
@pytest.mark.parametrize(
    ("card", "value"),
    [
        ("1k ; semi", 1e3),
        ("1k $ dollar", 1e3),
        ("1k // slashes", 1e3),
        ("1kOhm", 1e3),
        ("1MegaOhm", 1e6),
        ("1M", 1e-3),
        ("1A", 1.0),
        ("R=1k", 1e3),
        ("r = 1k", 1e3),
        ("1k m=2", 500.0),
        ("1mil", 25.4e-6),
        ("1x", 1.0),
        ("{1k*2}", 2e3),
        ("'1k+1k'", 2e3),
        ("1e3k", 1e6),
        ("1e", 1.0),
        ("10\u00b5", 1e-5),
        ("+5", 5.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("1k scale=3", 3e3),
        ("1k ac=3", 1e3),
        ("5 M=2", 2.5),
        ("5 noisy=0", 5.0),
        ("{2**3}", 8.0),
        ("{2^3}", 8.0),
        ("{-2**2+10}", 6.0),
        ("{2**-1}", 0.5),
        ("{log(10)}", math.log(10)),
        ("{log10(1000)}", 3.0),
        ("{5>3?7:9}", 7.0),
        ("{int(7.9)}", 7.0),
        ("{nint(8.5)}", 8.0),
        ("{sgn(-3)+5}", 4.0),
        ("{pwr(-2,2)}", 4.0),
        ("{10%4}", 2.0),
        ("{7\\2}", 3.0),
        ("{!0+3}", 4.0),
        ("{5&&3+1}", 1.0),
        ("{ternary_fcn(1,7,9)}", 7.0),
        ("{(1<2)+(2<1)}", 1.0),
        ("{1 < 2 ? 3 : 1 > 2 ? 5 : 7}", 3.0),
        ("{2+3?4:5}", 4.0),
        ("{7%3*2}", 2.0),
        ("{6/2*3}", 9.0),
        ("{-3**2+20}", 11.0),
        ("{int(-2.5)+9}", 7.0),
        ("{4 - -4}", 8.0),
        ("{asinh(1)}", math.asinh(1)),
    ],
)
def test_resistor_values_equal_those_of_ngspice(card: str, value: float) -> None:
    assert ohms(card) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("card", "more", "value"),
    [
        ("1k tc1=0.1 tc2 = 0.2", [".temp 37"], 22e3),
        ("1k tc=0.1 0.2", [".temp 37"], 22e3),
        ("1k tc1 = 0.1 dtemp=10", [], 2e3),
        ("1k tc1=0.1 temp=47", [], 3e3),
        ("mod 5", [".model mod r(tc1=0.1)", ".temp 37"], 10.0),
        ("5 mod", [".model mod r tc1=0.1 tnom=17"], 10.0),
        ("mod r=5", [".model mod r tc1=0.1 tnom=17", ".option temp=37"], 15.0),
        ("mod r=5", [".model mod r tc1=0.1", ".option temp=37 tnom=17"], 15.0),
        ("mod l=10u w=2u", [".model mod r(rsh=100 narrow=0.1u tc1=0.1)"], 100 * 10 / 1.8),
        ("mod l=10u w=2u", [".model mod res rsh=100 short=1u"], 400.0),
        ("mod l=10u", [".model mod r rsh=100 defw=2u narrow=0.1u"], 100 * 10 / 1.8),
        ("mod w=2u", [".model mod res rsh=100"], 500.0),
        ("mod", [".model mod r r=7"], 7.0),
        ("{rr}", [".param rr=5", ".param RR=6"], 6.0),
        ("{rr}", [".param rr = 'ss*2' ss=3"], 6.0),
        ("rr", [".param rr={ss*2}", ".param ss=3"], 6.0),
        ("{f(3)}", [".func f(x) {x*2}"], 6.0),
        ("{f(3)+g}", [".param f(x)='x*g'", ".param g=4"], 16.0),
        ("5\n* between\n\n \t+ m=2", [], 2.5),
    ],
)
def test_parameters_models_and_temperatures_give_the_expected_resistance(
    card: str, more: list[str], value: float
) -> None:
    assert ohms(card, *more) == pytest.approx(value, rel=1e-12)


def test_numbers_and_comments_follow_the_dialect() -> None:
    assert ohms("1x", dialect="hspice") == ohms("1X", dialect="xyce") == 1e6
    assert ohms("1x", dialect="ltspice") == 1.0
    assert ohms("1a", dialect="hspice") == 1e-18
    assert ohms("4k7", dialect="ltspice") == 4700.0
    assert "4k7" in rejection("R1 a 0 4k7")
    assert ohms("1k $ no comment in LTspice", dialect="hspice") == 1e3
    assert "'$'" in rejection("R1 a 0 1k $ x", dialect="ltspice")
    assert "//" in rejection("R1 a 0 1k // x", dialect="xyce")
    assert ohms("1k tc=0.1, 0.2", ".temp 37", dialect="ltspice") == pytest.approx(22e3)
    assert ohms("1k tc1=0.1", dialect="hspice") == 1e3
    assert ohms("1k tc1=0.1", ".temp 35", dialect="hspice") == pytest.approx(2e3)
    assert "log" in rejection("R1 a 0 {log(10)}", dialect="xyce")
    assert "^" in rejection("R1 a 0 {2^3}", dialect="ltspice")


@pytest.mark.parametrize(
    ("card", "message"),
    [
        ("D1 a 0 mod", "t>:2:1: D1 is a diode"),
        ("M1 d g s b mod", "MOS"),
        ("Q1 c b e mod", "bipolar"),
        ("E1 a 0 b 0 2", "controlled voltage source"),
        ("B1 a 0 i=v(a)", "behavioural"),
        ("T1 a 0 b 0 z0=50", "transmission line"),
        ("R1 a 0", "no value"),
        ("R1 a", "needs 2"),
        ("R1 a 0 wat", ":2:8: 'wat' is neither"),
        ("R1 a 0 1 2", "more than one"),
        ("R1 a 0 1k+1k", "1k+1k"),
        ("R1 a 0 0x10", "0x10"),
        ("R1 a 0 inf", "inf"),
        ("R1 a 0 1e400", "larger"),
        ("R1 a 0 1e-400", "smaller"),
        ("R1 a 0 1 foo=2", "'foo' is not supported"),
        ("R1 a 0 1 m=0", "positive"),
        ("R1 a 0 {1/0}", "division by zero"),
        ("R1 a 0 {2**3**2}", "parentheses"),
        ("R1 a 0 {(-3)**3}", "disagree"),
        ("R1 a 0 {1 +}", ":2:12: "),
        ("R1 a 0 {q}", "no parameter 'q'"),
        ("R1 a 0 {agauss(1,2,3)}", "statistical"),
        ("R1 a 0 {1k + 3*v(a, b)}", "the function 'v' is statistical, or depends on the solution"),
        ("R1 a 0 {1", "is unbalanced"),
        ("R1 a 0 tc1=1", "no value"),
        (".wat", "unknown command .wat"),
        (".if (1)", "conditions"),
        ("# a comment?", "neither a known element nor"),
        ("X1 a 0 s", "no subcircuit 's'"),
        (".ends", "closes no open subcircuit"),
        (".subckt s a\nR1 a 0 1", "no .ends"),
        (".param a={b} b={a}\nR1 x 0 {a}", "cycle"),
        (".func f(x) {f(x)}\nR1 x 0 {f(1)}", "calls itself"),
        ("+ 5", "continues"),
        (".include x.inc", "no folder"),
        (".control\nquit", "no .endc"),
        ("C1 a 0 -1u", "negative"),
        ("V1 a 0 am(1 2)", "not supported"),
        ("V1 a 0 1 2", "second value"),
        ("S1 a 0 b 0 sw\n.model sw sw", "no voltage source holds"),
        ("W1 a 0 v1 sw", "controlled by a current"),
        ("R1 a 0 1k\nX1 a s\nX1 a s\n.subckt s a\nR1 a 0 1\n.ends", "two instances are named X1"),
    ],
)
def test_unsupported_cards_raise_input_error_with_their_place(card: str, message: str) -> None:
    assert message in rejection(*card.split("\n"))


@pytest.mark.parametrize(
    ("value", "dialect", "remedy", "right"),
    [
        ("p*2", "ngspice", "write the expression in braces: {p*2}", 6.0),
        ("p*2", "hspice", "write the expression in quotes: 'p*2'", 6.0),
        ("-p^2+20", "ltspice", "write the expression in braces: {-p^2+20}", None),
        ("1k+p", "xyce", "write the expression in braces: {1k+p}", 1003.0),
        ("p*(2+p)", "ngspice", "write the whole expression in braces: {...}", None),
        ("p * 2", "ngspice", "write the whole expression in braces: {...}", None),
        ("(p)", "ngspice", "expected a value, or an expression in braces: {...}", None),
        ("4R7", "ngspice", "write the decimal point: 4.7", 4.7),
        ("0r33", "ltspice", "write the decimal point: 0.33", 0.33),
        ("1.2.3", "ngspice", "write a number, such as 4.7k", 4700.0),
        ("q", "ngspice", "define it with .param or .model", None),
    ],
)
def test_words_without_a_value_have_a_remedy_that_works(
    value: str, dialect: str, remedy: str, right: float | None
) -> None:
    assert remedy in rejection(".param p=3", "V1 b 0 1", f"R1 a 0 {value}", dialect=dialect)
    if right is not None:
        written = remedy.partition(": ")[2] or remedy.rpartition(" ")[2]
        assert ohms(written, ".param p=3", dialect=dialect) == pytest.approx(right)


@pytest.mark.parametrize("command", [".global_param g=2", ".sampling useexpr=true", ".options nonlin reltol=1e-6"])
def test_decks_with_commands_of_xyce_are_read_as_xyce(command: str) -> None:
    found = deck("I1 0 a 1", "R1 a 0 {PI}", command, dialect="auto")
    assert found.dialect == "xyce" and found.resistance[0] == pytest.approx(math.pi)


def test_a_constant_of_another_dialect_is_named_with_the_option_that_selects_it() -> None:
    lines = ("I1 0 a 1", "R1 a 0 {PI}")
    message = rejection(*lines)
    assert "or read the deck in its own dialect (--read-as, in Python dialect=)" in message
    assert "it is a constant of ltspice and xyce, not of ngspice" in message
    assert deck(*lines, dialect="ltspice").resistance[0] == pytest.approx(math.pi)
    assert "--read-as" not in rejection("I1 0 a 1", "R1 a 0 {pie}")


def test_at_most_20_errors_are_collected() -> None:
    message = rejection(*(f"D{i} a 0 mod" for i in range(30)))
    assert len(message.splitlines()) == 21
    assert "<text>:21:1" in message
    assert "after 20 errors" in message


def test_sources_have_their_dc_value() -> None:
    found = deck(
        *("V1 a 0 5", "V2 b 0 DC 5", "V3 c 0 dc=5 ac 1 0", "V4 d 0 ac 1 dc 5", "V5 e 0 dc 2 pulse(0 1 1u 2u)"),
        *("V6 f 0 pulse(3 1 1u)", "V7 g 0 sin(1 2 3 0 0 90)", "V8 h 0 pwl(-1 0 1 4)", "V9 i 0 pwl(1 3 2 4)"),
        *("V10 j 0 pulse 1 2 3", "V11 k 0", "V12 l 0 ac 1", "V13 m 0 exp(1 2 3)", "I1 0 a 2m m=3"),
    )
    assert found.source_volts.tolist() == [5, 5, 5, 5, 2, 3, 3, 2, 3, 1, 0, 0, 1]
    assert found.current_amps.tolist() == [6e-3]
    assert any("time 0" in note.text for note in found.notes)


def test_names_and_line_numbers_are_kept() -> None:
    found = deck(
        "Vdd VDD gnd 1",
        "X1 vdd Mid sub",
        "Rload mid 0 1k",
        ".SUBCKT Sub A B",
        "R1 a In 1",
        "L1 in B 1n",
        "Xin b inner",
        ".subckt inner q",
        "Rq q GND 5",
        ".ends",
        ".ends",
    )
    assert found.node_names == ("0", "VDD", "X1.In", "Mid")
    assert found.element_names["resistor"] == ("X1.R1", "X1.Xin.Rq", "Rload")
    assert found.element_names["voltage source"] == ("Vdd", "X1.L1")
    assert [ngspice_name(name) for name in found.element_names["voltage source"]] == ["vdd", "l.x1.l1"]
    assert found.place["resistor"][:, 1].tolist() == [6, 10, 4]
    assert found.place_of("resistor", 2) == "<text>:4"
    assert set(found.subcircuits) == {"Sub", "inner"}


def test_subcircuits_with_m_and_global_nodes_have_the_expected_voltage() -> None:
    found = deck("I1 0 a 1", "X1 a 0 s m=2", ".global rail", "Rg rail 0 1k", ".subckt s p q", "R1 p rail 1k", ".ends")
    voltage = dict(zip(found.node_names, rg.solve(found.netlist()).voltage, strict=True))
    assert voltage["a"] == pytest.approx(1500.0)
    assert "x1.rail" not in voltage


def test_subcircuit_parameters_are_overridden_by_instances() -> None:
    found = deck(
        *(".param r=3", "X1 a s params: r={r*2}", "X2 a s", "X3 a s r=1 k=5", "V1 a 0 1"),
        *(".subckt s p params: r=7 k=2", ".param both={r*k}", "R1 p 0 {both}", ".ends"),
    )
    assert found.resistance.tolist() == [12.0, 14.0, 5.0]
    assert "no parameter 'z'" in rejection("X1 a s z=1", ".subckt s p", "R1 p 0 1", ".ends")


def test_switches_with_a_known_control_become_resistors() -> None:
    lines = (
        "V1 c d 1",
        "V2 d 0 0.5",
        "S1 a 0 c 0 sw",
        "S2 a 0 0 c sw",
        "I1 0 a 1",
        ".model sw sw(ron=2 roff=1meg vt=1)",
    )
    assert deck(*lines).resistance.tolist() == [2.0, 1e6]
    window = ".model sw sw(ron=2 roff=1k vt=1.5 vh=0.2)"
    assert deck(*lines[:2], "S1 a 0 c 0 sw", "S2 a 0 c 0 sw on", window).resistance.tolist() == [1e3, 2.0]
    assert "neither on nor off" in rejection(*lines[:2], "S1 a 0 c 0 sw", ".model sw sw(vt=1.5)")


@pytest.mark.parametrize(
    ("first", "title", "resistors"),
    [
        ("R1 a b 2", None, 2),
        ("R1 x y 2", "R1 x y 2", 1),
        ("Resistor divider test 1k", "Resistor divider test 1k", 1),
        ("R-2R ladder network 8 bit", "R-2R ladder network 8 bit", 1),
        ("* a comment", "a comment", 1),
        ("", None, 1),
        (".title my deck", "my deck", 1),
        (".param x=1", None, 1),
        ("X1 a b wat", "X1 a b wat", 1),
    ],
)
@pytest.mark.parametrize("least", [0, 10**9])
def test_first_lines_are_titles_or_cards(tmp_path, first: str, title: str | None, resistors: int, least: int) -> None:
    from resgrid.spice.read.deck import read_with

    path = tmp_path / "deck.cir"
    path.write_text(f"{first}\nR2 b 0 1\nV1 a 0 1\n")
    found = read_with(path, least_bytes=least)
    assert (found.title, len(found.resistance)) == (title, resistors)
    if resistors == 2:
        assert found.element_names["resistor"] == ("R1", "R2")
        assert any("no title line" in note.text for note in found.notes)


def test_a_continued_first_line_is_a_card() -> None:
    found = rg.read_spice(io.StringIO("R1 a 0\n+ 5\nV1 a 0 1\n"))
    assert found.resistance.tolist() == [5.0]


def test_zero_resistances_become_sources_and_negative_ones_raise() -> None:
    found = deck("V1 a 0 1", "R1 a b 0", "R2 b 0 10", "R3 b 0 10")
    netlist = found.netlist()
    assert netlist.element_names is not None
    assert netlist.element_names["voltage source"] == ("V1", "R1")
    assert rg.solve(netlist).source_current.tolist() == pytest.approx([-0.2, 0.2])
    with pytest.raises(rg.InputError, match=r"<text>:3: resistor R2 has -5\.0 ohm"):
        deck("V1 a 0 1", "R2 a 0 -5").netlist()


@pytest.mark.parametrize(
    "data",
    [
        b"t\nV1 a 0 1\nR1 a 0 2",
        b"t\r\nV1 a 0 1\r\nR1 a 0 2\r\n.end\r\n",
        "\ufefft\nV1 a 0 1\nR1 a 0 2\n.END".encode(),
        "\ufefft\nV1 a 0 1\nR1 a 0 2\n.end".encode("utf-16"),
        "t\xe9\nV1 a 0 1 ; \xb5\nR1 a 0 2\n".encode("latin-1"),
        b"t\rV1 a 0 1\rR1 a 0 2\r",
    ],
)
def test_all_encodings_and_line_ends_are_read(tmp_path, data: bytes) -> None:
    path = tmp_path / "deck.cir"
    path.write_bytes(data)
    assert rg.read_spice(path).resistance.tolist() == [2.0]


def test_ignored_commands_are_noted() -> None:
    found = deck(
        *("V1 a 0 1", "R1 a 0 1", ".op", ".save all", ".tran 1 2", ".option reltol=1e-6 klu", ".ic v(a)=1"),
        *(".control", "run", "print all", ".endc", ".temp 50", ".end"),
    )
    said = " ".join(str(note) for note in found.notes)
    for word in (".op", ".save", ".tran", "options", ".ic", ".control"):
        assert word in said
    assert found.options == {"reltol": "1e-6", "klu": ""}
    assert (found.temperature, found.nominal_temperature) == (50.0, None)


def test_gnd_is_ground_except_in_xyce() -> None:
    lines = ("V1 a 0 1", "R1 a gnd 1", "R2 gnd 0 1")
    assert len(deck(*lines).node_names) == 2
    assert "gnd" in deck(*lines, dialect="xyce").node_names
    assert len(deck(*lines, ".preprocess replaceground true", dialect="xyce").node_names) == 2


def test_exponential_expansion_raises_budget_error() -> None:
    levels = [f".subckt n{i} a\nx1 a n{i + 1}\nx2 a n{i + 1}\n.ends" for i in range(30)]
    text = "t\n" + "\n".join([*levels, ".subckt n30 a\nR1 a 0 1\n.ends", "x1 a n0", "V1 a 0 1"]) + "\n"
    with pytest.raises(rg.BudgetError, match="elements"):
        rg.read_spice(io.StringIO(text))
    small = text.replace("x1 a n0", "x1 a n20")
    assert len(rg.read_spice(io.StringIO(small)).resistance) == 1024
    with pytest.raises(rg.BudgetError):
        rg.read_spice(io.StringIO(small), max_elements=1000)


def test_long_chains_of_parameters_are_resolved_in_any_order() -> None:
    forwards = ["V1 a 0 1", ".param c0=1", *(f".param c{i + 1}={{c{i}+1}}" for i in range(500)), "R1 a 0 {c500}"]
    assert deck(*forwards).resistance.tolist() == [501.0]
    assert deck(*reversed(forwards)).resistance.tolist() == [501.0]


def test_parsed_deck_arrays_are_read_only() -> None:
    found = deck("V1 a 0 1", "R1 a 0 1")
    with pytest.raises(ValueError, match="read-only"):
        found.resistance[0] = 2
    assert found.resistor_nodes.dtype == np.int32


def test_solve_factorize_and_check_erc_accept_a_circuit() -> None:
    read = rg.read_spice(io.StringIO("t\nV1 in 0 2\nR1 in out 1k\nR2 out 0 1k\n.end\n"))
    assert rg.check_erc(read) == ()
    assert rg.solve(read).voltage.tolist() == rg.solve(read.netlist()).voltage.tolist() == [0.0, 2.0, 1.0]
    assert rg.factorize(read).solve(np.ones(1)).tolist() == [500.0]
    with pytest.raises(rg.InputError, match="a list"):
        rg.solve([read])


def test_quoted_node_names_lose_their_quotes() -> None:
    found = deck('R1 "Net-(R1-Pad1)" 0 1k', 'V1 in "Net-(R1-Pad1)" 1', "R2 in 0 1k")
    assert found.node_names == ("0", "Net-(R1-Pad1)", "in")


def test_rser_of_ltspice_sources_is_a_series_resistor() -> None:
    found = deck("V1 a 0 2 Rser=1k", "R1 a 0 1k", dialect="ltspice")
    voltage = dict(zip(found.node_names, rg.solve(found).voltage.tolist(), strict=True))
    assert voltage == pytest.approx({"0": 0.0, "a": 1.0, "V1.rser": 2.0})
    assert "not supported" in rejection("V1 a 0 2 Rser=1k")
