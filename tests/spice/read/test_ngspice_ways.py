"""Peculiarities of ngspice: decks have the voltages of an ngspice run, or are rejected with name and place.

Tests internals: `resgrid.spice.dialects`, `resgrid.spice.read.expression_tokens`, `resgrid.spice.read.expressions`.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st
from support.simulators import run, waves

import resgrid as rg
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.read.expression_tokens import ExpressionError
from resgrid.spice.read.expressions import evaluate

HEAD = ("title", "V1 in 0 10", "R0 in a 1k")
SUBCIRCUIT = ".subckt s p q {}\nR9 p q {{r}}\n.ends"

SPICES = [name for name in DIALECTS if name != "spectre"]


def deck_in(folder: Path, *lines: str, head: tuple[str, ...] = HEAD, **files: str) -> Path:
    for name, content in files.items():
        (folder / f"{name}.inc").write_text(content)
    path = folder / "deck.cir"
    path.write_text("\n".join([*head, *lines, ".op", ".end", ""]))
    return path


def assert_ngspice_agrees(path: Path) -> None:
    deck = rg.read_spice(path, dialect="ngspice")
    voltage = rg.solve(deck.netlist()).voltage.tolist()
    run(path)
    expected = waves(path.parent / "out.raw")
    for name, volts in zip(deck.node_names[1:], voltage[1:], strict=True):
        assert volts == pytest.approx(expected[name.lower()][0], rel=1e-6), name


def rejection(path: Path, dialect: str = "ngspice") -> str:
    with pytest.raises(rg.InputError) as caught:
        rg.read_spice(path, dialect=dialect)
    return str(caught.value)


FOLLOWED = {
    "a thousandth of an inch by itself": (".model m r(rsh=100)", "R1 a 0 m l=6mil w=1mil", "R2 a 0 1e6mil"),
    "own name on an X line": (".param r=5", SUBCIRCUIT.format("r=1"), "X1 a 0 s r={r*200}"),
    "a name of equal value": (".param r=5 w=2", SUBCIRCUIT.format("r=1 w=7"), "X1 a 0 s r={100*w} w={w}"),
    "a function sees the names where it is called": (
        ".param g=2",
        ".func f(x) {x*g}",
        ".subckt s p q g=500\nR1 p q {f(1)}\n.ends",
        "X1 a 0 s",
    ),
    "calls after operators": (
        ".func f(x) {x+1}",
        "R1 a 0 {100*((2>1)&&(f(1)))+!(f(1))+7%(f(1))+(1?(f(1)):2)+(0||f(1))+(0?1:f(1))+7\\f(2)+(1<f(1))-f(1)}",
        "R2 a 0 {100*((2>1)&&abs(1))+!sgn(1)+7%int(2)}",
    ),
    "a call in a function that is not used": (".func f(x) {x+1}", ".func g(x) {1&&f(x)}", "R1 a 0 1k"),
    "a function is captured by another's argument": (
        ".param x=7",
        ".func f(y) {y*x}",
        ".func g(x) {f(x)+x}",
        "R1 a 0 {g(20)}",
    ),
    "a function of the place of its definition": (
        ".func f(x) {x}",
        ".subckt t p q\nR1 p q {f(500)}\n.ends",
        ".subckt s p q\n.func f(x) {2*x}\nX1 p q t\n.ends",
        "X1 a 0 s",
    ),
    "a model has the parameters of its place": (
        ".param q=200",
        ".model m r(r={q})",
        ".subckt s p n q=500\nR1 p n m\n.ends",
        "X1 a 0 s",
    ),
    "text after .end": ("R1 a 0 1k", ".op", ".end", "R2 a 0 {x}", ".param x=3k"),
    "two .end": ("R1 a 0 1k", ".end", ".end", "R2 a 0 1k"),
    ".temp before .option temp": ("R1 a 0 1k tc1=1e-3", ".temp 50", ".option temp=77"),
    "the last .temp": ("R1 a 0 1k tc1=1e-3", ".temp 50", ".option temp=60", ".temp 70"),
    "the first option of a line": ("R1 a 0 1k tc1=1e-3", ".option temp=50 temp=77 tnom=20 tnom=30"),
    "m= over plain elements": (".subckt s p q\nR1 p n 1k\nL1 n q 1\nI1 q p 1m\n.ends", "X1 a 0 s m=3"),
    "the first model": ("R1 a 0 m", ".model m r(r=1k)", ".model m r(r=2k)"),
    "sheet before r": ("R1 a 0 m", ".model m r(rsh=50 r=2k)"),
    "no sheet": ("R1 a 0 m l=2u w=1u", ".model m r(rsh=0 r=2k)"),
    "a model with a value": ("R1 a 0 5k m", "R2 a 0 m {5*1k}", ".model m r(r=7 tc1=1e-2)", ".temp 37"),
    "lists with blanks": ("R1 a 0 1k tc=1e-3 1e-5", "R2 a 0 2k tc={1m} {10u}", "R3 a 0 2k tc=1e-3, 1e-5", ".temp 77"),
    "a positive delay": ("V2 b 0 pulse(1 5 1u)", "R1 a b 1k", "I1 0 a sin(1m 2m 1k 1m 0 30)"),
    "a polygon": ("V2 b 0 pwl(-1u 1 1u 5)", "R1 a b 1k", "V3 c 0 pwl(-2u 1 -1u 4)", "R2 a c 1k"),
    "magnitude of a whole quotient": ("R1 a 0 {1000+(-7)\\2}", "R2 a 0 {1000-7\\2}", "R3 a 0 {1000+1%0.1}"),
    "signs of numbers": ("R1 a 0 {1000*-2+3000}", "R2 a 0 {2>-3?1k:2k}", "R3 a 0 {-(-1k)}"),
}


@pytest.mark.parametrize("name", FOLLOWED)
def test_voltages_of_peculiar_decks_equal_those_of_ngspice(tmp_path: Path, name: str) -> None:
    assert_ngspice_agrees(deck_in(tmp_path, *FOLLOWED[name]))


def test_dot_end_within_an_included_file_is_ignored_in_ngspice(tmp_path: Path) -> None:
    path = deck_in(tmp_path, ".include x.inc", "R3 a 0 2k", x="R1 a 0 1k\n.end\nR5 a 0 5\n")
    assert_ngspice_agrees(path)
    assert [(note.file, note.line) for note in rg.read_spice(path).notes if ".end" in note.text] == [
        (str(tmp_path / "x.inc"), 2)
    ]
    assert len(rg.read_spice(path, dialect="xyce").resistance) == 3


REJECTED = {
    "a thousandth of an inch in an expression": (("R1 a 0 {1k+6mil}",), ":4:12: '6mil': mil is milli"),
    "a thousandth of an inch given to a subcircuit": ((SUBCIRCUIT.format("r=1"), "X1 a 0 s r=6mil"), "mil is milli"),
    "a thousandth of an inch as a parameter": ((".param l=6mil", "R1 a 0 {l}"), "mil is milli"),
    "D for an exponent": (("R1 a 0 6d-1",), ":4:8: '6d-1': ngspice does not everywhere take D"),
    "D for an exponent in an expression": (("R1 a 0 {2*6D2}",), "does not everywhere take D"),
    "a name that the subcircuit has, too": (
        (".param w=1 l=4", SUBCIRCUIT.format("w=2 l=2 r=1"), "X1 a 0 s r={1k*l/w}"),
        ":8:10: ngspice takes l in r= for the l of s",
    ),
    "by a .param within": (
        (".param w=3", SUBCIRCUIT.format("r=1\n.param w=2"), "X1 a 0 s r={w}"),
        "takes w in r=",
    ),
    "by way of a function": (
        (".param w=3", ".func f(x) {x*w}", SUBCIRCUIT.format("r=1 w=2"), "X1 a 0 s r={f(2)}"),
        "takes w in r=",
    ),
    "swapped": ((".param w=3 r=7", SUBCIRCUIT.format("w=2 r=2"), "X1 a 0 s w={r} r={w}"), "rename one"),
    "m= over m=": (
        (".subckt s p q\nR1 p q 1k m=3\n.ends", "X1 a 0 s m=1"),
        ":7:10: in ngspice this m= replaces that of",
    ),
    "m= over a switch": (
        (".subckt s p q\nV8 c 0 2\nS1 p q c 0 m\n.ends", ".model m sw(vt=1)", "X1 a 0 s m=2"),
        "does not reach S1",
    ),
    "m= over a subcircuit": (
        ("X1 a 0 s m=2", ".subckt s p q\nX2 p q t\n.ends", ".subckt t p q\nR1 p q 1k\n.ends"),
        "does not reach X2",
    ),
    "m= and a parameter m": ((".param m=5", SUBCIRCUIT.format("r=1k"), "X1 a 0 s m=2"), "changes the parameter m"),
    "defl": (("R1 a 0 m", ".model m r(rsh=50 defl=40u)"), ":5:19: ngspice ignores defl; write l"),
    "dl": (("R1 a 0 m", ".model m r(rsh=50 dl=1u)"), "write short"),
    "tref": (("R1 a 0 m", ".model m r(r=50 tref=60)"), "write tnom"),
    "a first model of another kind": (("R1 a 0 m", ".model m c(c=1)", ".model m r(r=1)"), "one of kind 'c'"),
    "a list in parentheses": (("R1 a 0 1k tc=(1e-3,1e-5)",), "write tc1=... tc2=..."),
    "a list without a blank": (("R1 a 0 1k tc=1e-3,1e-5",), "write tc1=... tc2=..."),
    "a list of expressions with a comma": (("R1 a 0 1k tc={1m}, {10u}",), "write tc1=... tc2=..."),
    "a list that goes on with a point": (("R1 a 0 1k tc=.01 .001",), "write tc1=... tc2=..."),
    "a model after an expression": (("R1 a 0 {5} m", ".model m r(r=7)"), ":4:12: ngspice ignores the model m"),
    "a model after a parameter": (("R1 a 0 q m", ".param q=5", ".model m r(r=7)"), "write the model first"),
    "a model after a point": (("R1 a 0 .5 m", ".model m r(r=7)"), "write the model first"),
    "two temperatures": (("R1 a 0 1k", ".temp 30 40"), "ignores .temp with several"),
    "a temperature without braces": (("R1 a 0 1k", ".param t=40", ".option temp=t"), "write it in braces"),
    "a temperature with a unit": (("R1 a 0 1k", ".temp 40C"), "not a plain number"),
    "rseries": (("R1 a 0 1k", ".option rseries=3"), ":5:9: .option rseries adds elements"),
    ".alter": (("R1 a 0 1k", ".alter", "R1 a 0 2k"), "has no .alter"),
    "a choice within a choice": (("R1 a 0 {2>1?3>4?1k:2k:5k}",), "misreads a conditional"),
    "the sign of a name": ((".param a=1k", "R1 a 0 {3k+(1?-a:3)}"), ":5:15: ngspice misreads a sign"),
    "the sign of a power": (("R1 a 0 {2k-2*-3**2}",), "misreads a sign"),
    "a plus after an operator": (("R1 a 0 {2k*+3}",), "misreads a sign"),
    "a power of a negation": (("R1 a 0 {1k+!3**2}",), "applies ! before the power"),
    "a function of a built-in name after a negation": (
        (".func abs(x) {x+5}", "R1 a 0 {1k+!abs(0)}"),
        ":5:13: ngspice calls its own function abs directly after '!', not that of the deck: write (abs(...))",
    ),
}


@pytest.mark.parametrize("name", REJECTED)
def test_decks_that_ngspice_misreads_raise_input_error(tmp_path: Path, name: str) -> None:
    lines, message = REJECTED[name]
    assert message in rejection(deck_in(tmp_path, *lines))


@pytest.mark.parametrize("dialect", SPICES)
@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("pulse(1 5 -1u 1n 1n 5u 10u)", "negative delay"),
        ("sin(1 2 1k -0.25m)", "negative delay"),
        ("exp(1 2 -1u 1u 2u 1u)", "negative delay"),
        ("sffm(1 2 1k 2 100 30 60)", "differ on sffm"),
        ("pwl(0 1 0 2 1u 5)", "do not increase"),
        ("pwl(-2u 1 -1u 5 r=-2u)", "repeats before"),
        ("pwl(0 1 1u)", "without a value"),
        ("pulse(3)", "two values"),
        ("sin(1 2 1k) 7", "DC 7"),
    ],
)
def test_ambiguous_waveforms_need_a_dc_value(tmp_path: Path, source: str, message: str, dialect: str) -> None:
    head = ("title", f"V1 a 0 {source}", "R1 a 0 1")
    assert f":2:{8}: " in rejection(deck_in(tmp_path, head=head), dialect) or message == "DC 7"
    assert message in rejection(deck_in(tmp_path, head=head), dialect)
    if message in ("negative delay", "do not increase"):
        with_value = deck_in(tmp_path, head=("title", f"V1 a 0 {source} dc 3", "R1 a 0 1"))
        assert rg.read_spice(with_value, dialect=dialect).source_volts.tolist() == [3.0]


def test_a_global_terminal_raises_input_error_in_every_dialect(tmp_path: Path) -> None:
    path = deck_in(tmp_path, ".global vv", ".subckt s vv\nR1 vv 0 1k\n.ends", "V2 vv 0 3", "X1 a s")
    for dialect in SPICES:
        assert ":5: vv is a terminal of s and .global" in rejection(path, dialect)


def test_other_dialects_keep_their_own_rules(tmp_path: Path) -> None:
    def ohms(*lines: str) -> float:
        deck = rg.read_spice(deck_in(tmp_path, *lines, head=("title", "I1 0 a 1")), dialect="hspice")
        return 1.0 / float(deck.netlist().conductance.sum())

    local = ".option parhier=local"
    assert ohms(local, ".param w=1 l=4", SUBCIRCUIT.format("w=2 l=2 r=1"), "X1 a 0 s r={l/w}") == 4.0
    assert ohms("R1 a 0 5", ".end", "R2 a 0 5") == 5.0
    assert ohms("R1 a 0 1 tc1=0.1", ".temp 35", ".option temp=45") == pytest.approx(3.0)
    assert ohms(".subckt s p q\nR1 p q 6 m=3\n.ends", "X1 a 0 s m=2") == pytest.approx(1.0)
    assert ohms("R1 a 0 m", ".model m r(rsh=50 r=2)", ".model m r(rsh=50 r=3)") == 3.0
    assert ohms("R1 a 0 m", ".model m r(rsh=50 defl=20u)") == pytest.approx(100.0)
    assert ohms(".param p=3", "R1 a 0 {2>1?3>4?1:2:5}", "R2 a 0 {8*(1?--1:-p)}") == pytest.approx(1.6)
    assert ohms(local, ".param g=2", ".func f(x) {x*g}", ".subckt s p q g=5\nR1 p q {f(1)}\n.ends", "X1 a 0 s") == 2.0


def test_ltspice_annotations_are_ignored_with_a_note(tmp_path: Path) -> None:
    head = ("title", "V1 a 0 SINE(1 2 1k)", "R1 a 0 1k tol=1 pwr=0.1")
    deck = rg.read_spice(deck_in(tmp_path, head=head), dialect="ltspice")
    assert (deck.resistance.tolist(), deck.source_volts.tolist()) == ([1000.0], [1.0])
    assert any("pwr= has no effect" in note.text for note in deck.notes)
    assert "'tol' is not supported" in rejection(deck_in(tmp_path, head=head))


def test_an_ignored_rshunt_option_causes_a_warning(tmp_path: Path) -> None:
    deck = rg.read_spice(deck_in(tmp_path, "R1 a 0 1k", ".option rshunt=1k"))
    assert [note.line for note in deck.notes if note.severity == "warning" and "rshunt" in note.text] == [5]


def test_exponential_functions_and_includes_raise_budget_error(tmp_path: Path) -> None:
    doubling = "\n".join(f".func f{i}(x) {{f{i - 1}(x)+f{i - 1}(x)}}" for i in range(1, 40))
    with pytest.raises(rg.BudgetError, match=r"deck.cir:\d+:\d+: one value takes more than 10,000 calls"):
        rg.read_spice(deck_in(tmp_path, ".func f0(x) {x}", doubling, "R1 a 0 {f39(1)}"))
    for i in range(1, 19):
        (tmp_path / f"x{i}.inc").write_text(f".include x{i - 1}.inc\n.include x{i - 1}.inc\n")
    with pytest.raises(rg.BudgetError, match=r"x\d+.inc:\d:\d+: more than 2,000 files are included"):
        rg.read_spice(deck_in(tmp_path, ".include x18.inc", x0="* nothing\n"))


names = st.sampled_from(("a", "b", "c"))
numbers = st.sampled_from(("1", "2.5", "1k", "7", "0"))
OPERATORS = ("+", "-", "*", "/", "%", "\\", "**", "<", ">=", "==", "&&", "||")


def nested(depth):
    """Expressions with at most `depth` levels of operators."""
    if not depth:
        return names | numbers
    inner = nested(depth - 1)
    return inner | st.one_of(
        st.tuples(inner, st.sampled_from(OPERATORS), st.sampled_from(("", "-", "!")), inner),
        st.tuples(st.sampled_from(("-", "+", "!")), inner),
        st.tuples(st.just("("), inner, st.just(")")),
        st.tuples(inner, st.just("?"), inner, st.just(":"), inner),
        st.tuples(st.sampled_from(("sqrt(", "abs(", "int(", "ceil(")), inner, st.just(")")),
        st.tuples(st.sampled_from(("min(", "max(", "pow(")), inner, st.just(","), inner, st.just(")")),
    ).map("".join)


expressions = nested(3)
VALUES = {"a": 3.0, "b": -2.0, "c": 0.0}


@given(st.lists(expressions, min_size=60, max_size=60))
@settings(max_examples=5)
def test_values_of_random_expressions_equal_those_of_ngspice(
    tmp_path_factory: pytest.TempPathFactory, texts: list[str]
) -> None:
    worth: dict[str, float] = {}
    for text in texts:
        try:
            value = evaluate(text, DIALECTS["ngspice"].reading, VALUES.get, lambda *_: None)
        except ExpressionError:
            continue
        if 1e-3 < math.fabs(value) < 1e9:
            worth[text] = value
    lines = [f"I{i} 0 n{i} 1\nR{i} n{i} 0 {{{text}}}" for i, text in enumerate(worth)]
    path = deck_in(
        tmp_path_factory.mktemp("deck"), *lines, head=("title", ".param a=3 b=-2 c=0", "V1 z 0 1", "Rz z 0 1")
    )
    run(path)
    found = waves(path.parent / "out.raw")
    for i, (text, value) in enumerate(worth.items()):
        assert found[f"n{i}"][0] == pytest.approx(value, rel=1e-9), text
