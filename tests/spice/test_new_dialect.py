"""A user-defined dialect needs one record and one table entry: writing, reading, checks, analyses.

Tests internals: `resgrid.spice.dialects`, `resgrid.spice.dialects.record`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import cli
from support.circuits import random_grid
from support.spaces import space_of
from support.tiles import tiled

import resgrid as rg
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.dialects.record import Dialect, Quirks, ReadingRules, Statements

SPARROW = Dialect(
    name="sparrow",
    label="Sparrow",
    reserved=frozenset({"earth"}),
    comment="* ",
    preamble=(".option sparrow=1",),
    expression="'{value}'",
    parameter=".define {name}={value}",
    nonlinear_resistor="{name} {a} {b} i={current}*tanh(v({a},{b})/{voltage})",
    statements=Statements(
        first=("* sparrow {deck}.sparrow",),
        operating=(".op",),
        transient=(".transient {stop} {step}",),
        noise=(".noise v({node}) {source} {points} {start} {stop}",),
        temperature=(".temperatures {temperatures}",),
        mismatch=(".draw {runs} {seed}",),
        probe=".keep {what}",
        maximum=".highest {name} v({node})",
    ),
    quirks=Quirks(smallest_resistance=1.0, floating="there"),
    reading=ReadingRules(name="sparrow", signs=(b".option sparrow",), grounds=frozenset({"0", "gnd"})),
)


@pytest.fixture(autouse=True)
def sparrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DIALECTS, "sparrow", SPARROW)


def test_a_deck_is_written_and_read_back(tmp_path: Path) -> None:
    op = rg.solve(random_grid(3))
    written = rg.write_spice(op, tmp_path / "a.cir", "sparrow")
    assert written.commands.read_text() == (
        '* operating point of a.cir\n* sparrow a.cir.sparrow\n.op\n.include "a.cir"\n.end\n'
    )
    read = rg.read_spice(written.path)
    assert read.dialect == "sparrow"
    names = op.netlist.names_of(np.arange(op.netlist.node_count))
    there = rg.solve(read)
    order = [there.netlist.node_names.index(name) for name in names]
    np.testing.assert_allclose(there.voltage[order], op.voltage, rtol=0, atol=1e-12)
    assert not [violation for violation in rg.check_erc(read) if violation.severity == "error"]
    agreement = rg.check_deck(written.path)
    assert not agreement.verified and agreement.as_read.agrees and "sparrow" in agreement.remark


def test_quirks_of_the_dialect_appear_in_predictions(tmp_path: Path) -> None:
    (tmp_path / "a.cir").write_text("* t\n.option sparrow=1\nv1 a 0 1\nr1 a b 0.5\nr2 b 0 1\nr3 gnd b 1k\n.end\n")
    read = rg.read_spice(tmp_path / "a.cir")
    prediction = next(item for item in rg.spice.check_portability(read) if item.simulator == "sparrow")
    assert (prediction.outcome, prediction.basis) == ("wrong", "documented")
    assert "become 1 ohm" in prediction.reasons[0]
    named = rg.Netlist(2, [[1, 0]], [1.0], node_names=("0", "GND"), source_nodes=[[1, 0]], source_volts=[1.0])
    assert any("Sparrow" in violation.message for violation in rg.check_erc(named))


def test_analyses_and_tiles_use_its_statements(tmp_path: Path) -> None:
    netlist, chip = tiled(space_of([[0, 1], [0, 2]]), rg.Chip(capacitance=1e-12))
    asked = [
        rg.spice.analyses.TransientAnalysis(1e-6, 1e-9),
        rg.spice.analyses.Measure("top", "n_0_0", "maximum"),
        rg.spice.analyses.Probe(("n_0_0",)),
    ]
    written = rg.write_spice(netlist, tmp_path / "a.cir", "sparrow", form="cells", chip=chip, analyses=asked)
    lines = written.commands.read_text().splitlines()
    assert {".transient 1e-06 1e-09", ".highest top v(n_0_0)", ".keep v(n_0_0)"} <= set(lines)
    assert ".define state_0_1=1" in written.pattern.read_text()
    assert "'resistance_0'" in written.chip.read_text()


def test_the_command_line_accepts_the_dialect(scenes: Path) -> None:
    result = cli.call("compile", scenes / "lesson.toml", "--dialect", "sparrow")
    assert "* sparrow dialect" in result.stdout and ".option sparrow=1" in result.stdout
