"""The optional engine eecircuit, replaced by a program with the same protocol, so that Node is not needed.

Tests internals: `resgrid.spice.run`, `resgrid.spice.run.eecircuit`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from support.circuits import random_grid

import resgrid as rg
from resgrid.spice.run import engine_named
from resgrid.spice.run.eecircuit import find_module, simulate_eecircuit

FAKE = """#!{python}
import pathlib, subprocess, sys
script, module, deck, raw = sys.argv[1:]
assert script.endswith("eecircuit.mjs") and module.endswith("engine.mjs")
text = pathlib.Path(deck).read_text().lower()
assert text.count(".end\\n") == 1 and text.count(".op\\n") == 1
{body}
words = ["ngspice", "-n", "-b", "-r", raw, deck]
done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True)
print("Command: ngspice-45.2, Build")
print(done.stdout, done.stderr)
"""


@pytest.fixture
def engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A discoverable package and a substitute for Node that runs ngspice."""
    package = tmp_path / "modules" / "eecircuit-engine"
    package.mkdir(parents=True)
    (package / "package.json").write_text(json.dumps({"module": "./engine.mjs"}))
    (package / "engine.mjs").write_text("")
    monkeypatch.setenv("NODE_PATH", f"{tmp_path / 'nothing'}:{tmp_path / 'modules'}")
    monkeypatch.delenv("RESGRID_EECIRCUIT", raising=False)
    return fake_node(tmp_path, monkeypatch)


def fake_node(folder: Path, monkeypatch: pytest.MonkeyPatch, body: str = "") -> Path:
    node = folder / "node"
    node.write_text(FAKE.format(python=sys.executable, body=body))
    node.chmod(0o755)
    monkeypatch.setenv("RESGRID_NODE", str(node))
    return node


def test_the_engine_gives_the_results_of_ngspice(engine: Path) -> None:
    netlist = random_grid(5)
    agreement = rg.check_deck(netlist, engine="eecircuit")
    assert agreement.agrees, agreement.findings
    assert (agreement.simulator, agreement.version) == ("eecircuit-engine", "45.2")


def test_complaints_of_the_engine_are_reported(engine: Path) -> None:
    simulation = simulate_eecircuit(b"* t\nv1 a 0 1\nr1 a b 1k\nr2 b 0 1k\nr3 c d 1k\n.end\n")
    assert any("singular" in complaint for complaint in simulation.complaints)


def test_an_engine_without_output_and_a_slow_one_are_reported(
    engine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_node(tmp_path, monkeypatch, "print('Error: circuit not parsed.'); sys.exit(1)")
    simulation = simulate_eecircuit(b"* t\nv1 a 0 1\nr1 a 0 1k\n.end\n")
    assert not simulation.voltage and "no raw file" in simulation.complaints[0]
    fake_node(tmp_path, monkeypatch, "import time; time.sleep(30)")
    with pytest.raises(rg.BudgetError, match="eecircuit-engine did not finish"):
        simulate_eecircuit(b"* t\nv1 a 0 1\nr1 a 0 1k\n.end\n", timeout=0.5)


def test_decks_with_commands_are_not_run(engine: Path) -> None:
    with pytest.raises(rg.InputError, match="not simulated"):
        simulate_eecircuit(b"* t\n.control\nshell ls\n.endc\n.end\n")
    with pytest.raises(rg.InputError, match="model"):
        simulate_eecircuit(b"* t\n.model a r\n.end\n")
    assert simulate_eecircuit(b"* t\nv1 a 0 1\nr1 a 0 1k\n.model m r(r=1)\n.op\n.end\n", direct=True).voltage == {
        "a": 1.0
    }


def test_missing_node_and_package_raise_tool_missing_error(
    engine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RESGRID_NODE", "no-such-node")
    with pytest.raises(rg.ToolMissingError, match="nodejs"):
        simulate_eecircuit(b"* t\n")
    monkeypatch.setenv("RESGRID_EECIRCUIT", str(tmp_path))
    with pytest.raises(rg.ToolMissingError, match="npm install eecircuit-engine"):
        find_module()
    (tmp_path / "package.json").write_text("[")
    with pytest.raises(rg.ToolMissingError):
        find_module()
    with pytest.raises(rg.InputError, match="choose one of ngspice, eecircuit"):
        engine_named("spice3")
