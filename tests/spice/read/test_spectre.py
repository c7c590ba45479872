"""Decks in Spectre's language, compared with literals, and round trips of written decks in every dialect.

Tests internals: `resgrid.spice.dialects`.
"""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest

import resgrid as rg
from resgrid.spice.dialects import DIALECTS

DECK = """// a divider
simulator lang=spectre
global 0 vdd!
parameters rload=2k \\
           half = rload/2
subckt divider (in out)
parameters r=1 factor=2.0
r1 (in out) resistor r=r*factor
r2 (out 0) resistor r=r tc1=1e-3 m=2  // two in parallel
ends divider
model thin resistor tc1=2e-3
v1 (vdd! 0) vsource dc=1.5 type=dc
i1 (0 b) isource dc=1m m=2
x1 (vdd! mid) divider r=half
x2 (mid
+   b) divider r=(rload + 1K) factor=3
r3 b 0 thin r=1M
c1 (b 0) capacitor c=1p
l1 (b c) inductor l=1n
p1 (c d) iprobe
r4 (d 0) resistor r=10k
save b
simulatorOptions options temp=27 reltol=1e-9
dcOp dc write="spectre.dc" maxiters=150
sweeps sweep param=temp values=[0 27] {
  point dc oppoint=rawfile
}
simulator lang=spice
r5 d 0 5m
.param x=1meg
r6 d 0 {x}
simulator lang=spectre
r7 (d 0) resistor r=5m
"""


def read(text: str, dialect: str = "auto") -> rg.spice.Circuit:
    return rg.read_spice(io.StringIO(text), dialect=dialect)


def test_a_deck_in_spectre_and_spice_language_is_read() -> None:
    deck = read(DECK)
    assert (deck.dialect, deck.title, deck.temperature) == ("spectre", "a divider", 27.0)
    ohms = dict(zip(deck.element_names["resistor"], deck.resistance.tolist(), strict=True))
    assert ohms == {
        "x1.r1": 2000.0, "x1.r2": 500.0, "x2.r1": 9000.0, "x2.r2": 1500.0, "r3": 1e6, "r4": 1e4, "r5": 5e-3, "r6": 1e6,
        "r7": 5e-3,
    }  # fmt: skip
    assert deck.tc1 is not None
    assert dict(zip(ohms, deck.tc1.tolist(), strict=True))["r3"] == 2e-3
    assert deck.source_volts.tolist() == [1.5, 0.0, 0.0]
    assert deck.current_amps.tolist() == [2e-3]
    assert deck.capacitance.tolist() == [1e-12]
    assert np.isfinite(rg.solve(deck).voltage).all()
    assert [note.line for note in deck.notes if "several runs" in note.text] == [25]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("r1 (a 0) resistor r=1meg", ":3:21: '1meg' has letters after its suffix"),
        ("r1 (a 0) resistor r=x", ":3:21: 'x' is neither a number nor a known parameter"),
        ("r1 (a) resistor r=1", ":3: r1 has 1 node"),
        ("d1 (a 0) diode area=1", "there is no subcircuit 'diode'"),
        ("b1 (a 0) bsource i=v(a,0)**2", "only .* can be read"),
        ("v1 (a 0) vsource type=pulse val0=1", "dc="),
        ("v1 (a 0) vsource dc=1 phi=2", ":3:23: 'phi' is not supported"),
        ("r1 (a 0) resistor r=1 wrong=2", ":3:23: 'wrong' is not supported"),
        ("library x", ":3:1: the statement library is not supported"),
        ("statistics {", "not closed"),
        ("parameters A=1\nparameters a=2", ":4:12: a and A are two names in spectre"),
        ("r1 (a 0) resistor r=1\nr2 (A 0) resistor r=1", "differ by case alone"),
        ("m1 (a 0) nch w=1\nmodel nch bsim4 vth=1", "model of kind 'bsim4'"),
        ("r1 (a 0) rm w=1u l=2u\nmodel rm resistor rsh=100", "rsh of a model is not read; write the resistance"),
        ("simulator lang=verilog", "verilog"),
        ("r1 (a 0) resistor r=1 \\\nsimulator lang=spice", ":4:1: unexpected 'simulator'"),
    ],
)
def test_unsupported_statements_raise_input_error_with_their_place(line: str, message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        read(f"// title\nsimulator lang=spectre\n{line}\n")


def test_a_section_of_a_library_is_included(tmp_path: Path) -> None:
    (tmp_path / "lib.scs").write_text(
        "// corners\nlibrary corners\nsection slow\nparameters k=2\nendsection slow\nsection fast\n"
        "parameters k=1\nendsection fast\nendlibrary\n"
    )
    deck = tmp_path / "deck.scs"
    deck.write_text('// t\ninclude "lib.scs" section=slow\nr1 (a 0) resistor r=k*1K\nv1 (a 0) vsource dc=1\n')
    assert rg.read_spice(deck).resistance.tolist() == [2000.0]
    deck.write_text('// t\ninclude "lib.scs" section=typical\n')
    with pytest.raises(rg.InputError, match=r"deck\.scs:2:19: .*lib\.scs has no section 'typical'"):
        rg.read_spice(deck)


def saturating(seed: int) -> rg.Netlist:
    """A small circuit with every kind of element of decks."""
    rng = np.random.default_rng(seed)
    return rg.Netlist(
        5,
        [[1, 2], [2, 3], [3, 0], [4, 0]],
        10.0 ** rng.uniform(-6, 0, 4),
        source_nodes=[[1, 0]],
        source_volts=[2.5],
        current_nodes=[[0, 3]],
        current_amps=[1e-3],
        capacitor_nodes=[[2, 0]],
        capacitance=[1e-12],
        tc1=rng.normal(size=4) * 1e-3,
        tc2=rng.normal(size=4) * 1e-6,
        nonlinear_nodes=[[2, 4], [3, 4]],
        nonlinear_current=10.0 ** rng.uniform(-9, 0, 2),
        nonlinear_voltage=rng.uniform(0.01, 1, 2),
        node_names=("0", "in", "a", "b", "c"),
    )


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("seed", range(3))
def test_written_decks_read_back_as_the_same_circuit(tmp_path: Path, dialect: str, seed: int) -> None:
    netlist = saturating(seed)
    path = tmp_path / "deck.cir"
    rg.write_spice(netlist, path, dialect)
    circuit = rg.read_spice(path)
    back = circuit.netlist()
    assert circuit.dialect == dialect
    number = {name: node for node, name in enumerate(back.names_of(range(5)))}
    same = np.array([number[name] for name in netlist.names_of(range(5))])
    for nodes, values in (
        ("resistor_nodes", ("conductance", "tc1", "tc2")),
        ("source_nodes", ("source_volts",)),
        ("current_nodes", ("current_amps",)),
        ("capacitor_nodes", ("capacitance",)),
        ("nonlinear_nodes", ("nonlinear_current", "nonlinear_voltage")),
    ):
        ends = [tuple(pair) for pair in same[getattr(netlist, nodes)].tolist()]
        order = [[tuple(pair) for pair in getattr(back, nodes).tolist()].index(pair) for pair in ends]
        for value in values:
            assert getattr(back, value)[order] == pytest.approx(getattr(netlist, value), rel=1e-15), value
    again = rg.write_spice(back, tmp_path / "again.cir", dialect)
    assert rg.read_spice(again.path).nonlinear_current.tolist() == circuit.nonlinear_current.tolist()


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("text", ["b1 a 0 i=1*tanh(v(0,a)/1)", "b1 a 0 i=-1*tanh(v(a,0)/1)", "b1 a 0 i=v(a,0)"])
def test_other_behavioural_sources_raise_input_error(dialect: str, text: str) -> None:
    if dialect != "spectre":
        with pytest.raises(rg.InputError, match=r"behavioural|positive|controlled"):
            read(f"t\n{text}\n", dialect)


def test_a_backslash_joins_one_line_only_even_a_blank_one() -> None:
    lines = ("r1 (a 0) resistor r=1 \\", "", "r2 (a 0) resistor \\", "  r=2", "v (a 0) vsource dc=1", "")
    deck = read("simulator lang=spectre\n" + "\n".join(lines))
    assert dict(zip(deck.element_names["resistor"], deck.resistance.tolist(), strict=True)) == {"r1": 1.0, "r2": 2.0}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("subckt s (a b)\nr1 (a b) resistor r=1\n", "subckt s has no ends"),
        ("subckt\nends\n", "subckt needs a name and its terminals"),
        ("model m\n", "model needs a name and a kind"),
        ("include\n", "include needs the name of one file"),
        ("r1 (a 0) resistor r=x+1\n", "define it with parameters"),
        (
            "r1 (a 0) resistor r=1 foo=2\n",
            "supported here are l, m, r, resistance, scale, tc, tc1, tc2, temp, trise, w",
        ),
        (
            "b1 (a 0) bsource i=v(a)*v(a)\n",
            "vsource, isource, iprobe and subcircuits and B1",
        ),
        (
            "global p\nsubckt s (q p)\nr1 (q p) resistor r=1\nends\nx (a b) s\nglobal 0 p\nv (a 0) vsource dc=1\n",
            "p is a terminal of s and global;",
        ),
    ],
)
def test_messages_use_keywords_of_the_language(text: str, says: str) -> None:
    with pytest.raises(rg.InputError) as caught:
        read(f"simulator lang=spectre\n{text}")
    assert says in str(caught.value)
    assert not re.search(r"\.(subckt|ends|model|param|global|include)", str(caught.value))


def test_notes_use_keywords_of_the_language() -> None:
    asked = "statistics {\n}\ns sweep param=temp values=[1 2] {\n o dc\n}\nic a=1\nop dc\n"
    deck = read(f"simulator lang=spectre\nr1 (a 0) resistor r=1\nv (a 0) vsource dc=1\n{asked}")
    assert [note.text.split()[0] for note in deck.notes] == ["statistics", "sweep", "ic", "dc"]


@pytest.mark.parametrize(("master", "severity"), [("vsource dc=0", "error"), ("inductor l=1n", "warning")])
def test_the_master_determines_the_kind_of_an_instance(master: str, severity: str) -> None:
    deck = read(f"* loop\nsimulator lang=spectre\nv1 (a 0) vsource dc=1\nlow (a b) {master}\nlate (b a) {master}\n")
    loops = [violation for violation in rg.check_erc(deck) if violation.rule == "voltage loop"]
    assert [violation.severity for violation in loops] == [severity]
