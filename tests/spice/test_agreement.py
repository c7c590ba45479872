"""`rg.check_deck`: agreement of ngspice with dense and with resgrid's solutions, and detection of changes.

Tests internals: `resgrid.spice.check.agreement`, `resgrid.spice.check.kcl_location`, `resgrid.spice.run.ngspice`,
`resgrid.spice.write.flat`, `resgrid.spice.write.sidecar`.
"""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from support.circuits import dense_solution, ladder, random_grid
from support.spaces import serpentine, space_of, spaces

import resgrid as rg
from resgrid.spice.check.agreement import compare
from resgrid.spice.check.kcl_location import inspect_deck
from resgrid.spice.run.ngspice import SimulatorRun
from resgrid.spice.write.flat import flatten
from resgrid.spice.write.sidecar import altered_lines, expect, read_sidecar


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    netlist = random_grid(3)
    path = tmp_path_factory.mktemp("deck") / "grid.cir"
    rg.write_spice(dense_solution(netlist), path)
    return path


@pytest.fixture
def deck(original: Path, tmp_path: Path) -> Path:
    for file in original.parent.iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path / original.name


def lines_of(deck: Path) -> list[str]:
    return deck.read_text().split("\n")


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 2.0, 6.0]), st.booleans())
def test_ngspice_agrees_with_a_dense_solution(seed: int, decades: float, drive: bool) -> None:
    netlist = random_grid(seed, decades=decades, drive=drive)
    agreement = rg.check_deck(dense_solution(netlist))
    assert agreement.findings == ()
    assert agreement.agrees
    assert agreement.nodes == netlist.node_count - 1
    assert agreement.max_relative_error is not None
    assert agreement.max_relative_error < 1e-11


@pytest.mark.parametrize("rules", [{"boundary": "dirichlet"}, {"boundary": "neumann"}])
@pytest.mark.parametrize("seed", range(3))
def test_ngspice_agrees_on_compiled_spaces(rules: dict[str, str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    cell = (rng.random((12, 12)) < 0.3).astype(np.uint8)
    cell[2:4, 5], cell[9, 9] = 2, 2
    netlist = rg.compile_space(space_of(cell), resistance=10e3, **rules)
    agreement = rg.check_deck(netlist)
    assert agreement.findings == ()
    assert agreement.agrees


def test_a_wrong_solution_is_reported_with_its_worst_node() -> None:
    netlist = ladder(4)
    point = dense_solution(netlist)
    voltage = point.voltage.copy()
    voltage[3] += 1e-6
    agreement = rg.check_deck(replace(point, voltage=voltage))
    assert not agreement.agrees
    assert agreement.worst[0][0] == "node_3"
    assert agreement.max_abs_error == pytest.approx(1e-6, rel=1e-6)
    assert agreement.max_relative_error == pytest.approx(1e-6, rel=1e-3)
    assert "node node_3" in agreement.findings[0]


def test_an_untouched_deck_agrees(deck: Path) -> None:
    agreement = rg.check_deck(deck)
    assert agreement.findings == ()
    assert agreement.agrees
    assert (agreement.reference, agreement.simulator, agreement.nodes) == ("sidecar", "ngspice", 39)


@pytest.mark.slow
@settings(max_examples=25)
@given(st.data())
def test_any_changed_byte_of_a_deck_fails_the_check(original: Path, data: st.DataObject) -> None:
    text = original.read_bytes()
    place = data.draw(st.integers(0, len(text) - 1))
    byte = data.draw(st.integers(0, 255).filter(lambda value: value != text[place]))
    folder = original.parent.parent / "tampered"
    folder.mkdir(exist_ok=True)
    shutil.copy(original.parent / "grid.cir.json", folder)
    (folder / "grid.cir").write_bytes(text[:place] + bytes([byte]) + text[place + 1 :])
    agreement = rg.check_deck(folder / "grid.cir", timeout=300)
    assert not agreement.agrees
    line = text.count(b"\n", 0, place) + 1
    ranges = altered_lines((folder / "grid.cir").read_bytes(), read_sidecar(folder / "grid.cir"))
    assert any(first <= line <= last for first, last in ranges)
    assert f"lines {ranges[0][0]}-" in agreement.findings[0]


@pytest.mark.parametrize("suffix", [".json", ".verify", ".ngspice"])
def test_any_changed_byte_of_companion_files_fails_the_check(deck: Path, suffix: str) -> None:
    file = deck.with_name(deck.name + suffix)
    text = file.read_bytes()
    for place in np.random.default_rng(3).integers(0, len(text), 6).tolist():
        file.write_bytes(text[:place] + bytes([text[place] ^ 1]) + text[place + 1 :])
        try:
            agreement = rg.check_deck(deck)
        except rg.InputError as error:  # the changed bytes are not a valid sidecar
            assert suffix == ".json" and file.name in str(error)
        else:
            assert not agreement.agrees
            assert any(finding.startswith(f"{file.name} differs from") for finding in agreement.findings)
    file.write_bytes(text)
    assert rg.check_deck(deck).agrees


def test_a_changed_cell_map_fails_the_check(deck: Path) -> None:
    sidecar = deck.with_name("grid.cir.json")
    content = json.loads(sidecar.read_text())
    content["nodes"]["node_12"]["cell"] = [9, 9]
    del content["own_sha256"]
    sidecar.write_text(json.dumps(content))
    agreement = rg.check_deck(deck)
    assert not agreement.agrees and agreement.max_relative_error < 1e-9
    assert agreement.findings == ("grid.cir.json differs from what resgrid wrote (its own SHA-256)",)


def test_mixed_files_of_two_decks_fail_the_check(tmp_path: Path) -> None:
    """Files are renamed one by one, the deck last: any intermediate state contradicts a hash."""
    old, new = tmp_path / "old", tmp_path / "new"
    for folder, seed in ((old, 3), (new, 4)):
        folder.mkdir()
        rg.write_spice(dense_solution(random_grid(seed)), folder / "grid.cir")
    for name in ("grid.cir.verify", "grid.cir.json"):
        shutil.copy(new / name, old / name)
        assert not rg.check_deck(old / "grid.cir").agrees
    shutil.copy(new / "grid.cir", old / "grid.cir")
    assert rg.check_deck(old / "grid.cir").agrees


@pytest.mark.parametrize("cut", [0, 1, 100, -1, -5, -200])
def test_a_truncated_deck_fails_the_check(deck: Path, cut: int) -> None:
    deck.write_bytes(deck.read_bytes()[:cut])
    agreement = rg.check_deck(deck)
    assert not agreement.agrees
    assert "differ from the deck that resgrid wrote" in agreement.findings[0]


def test_a_changed_resistor_is_found_despite_parts_without_current() -> None:
    space = space_of(serpentine(7, 40, 3))
    free = np.argwhere(space.cell == 0)
    netlist = rg.compile_space(space, boundary="neumann", drive="start", start=free[len(free) // 2].tolist())
    point = rg.solve(netlist)
    deck = flatten(netlist)
    expected = expect(deck, point)
    assert inspect_deck(deck.text.encode(), expected, 1e-6) == []
    worst = int(np.argmax(np.abs(point.resistor_current)))
    tripled = flatten(
        netlist.replace(
            conductance=np.where(np.arange(len(netlist.conductance)) == worst, 1 / 3, 1) * netlist.conductance
        )
    )
    assert inspect_deck(tripled.text.encode(), expected, 1e-6)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("r_x n_1 0 0", "0 ohm"),
        ("r_x n_1 0 -5", "-5 ohm"),
        (".temp 99", ".temp is set"),
        (".option gmin=1e-9", "gmin is set"),
        ("d_x n_1 0 dd", "a diode"),
        ("r_x y 0 5", "names the node y"),
    ],
)
def test_an_added_line_is_found_without_the_hash(line: str, message: str) -> None:
    deck = flatten(
        rg.Netlist(
            3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[1.0], node_names=("0", "n_1", "n_2")
        )
    )
    expected = expect(deck, rg.solve(deck.netlist))
    assert inspect_deck(deck.text.encode(), expected, 1e-9) == []
    changed = deck.text.replace(".end\n", f"{line}\n.end\n").encode()
    assert message in "\n".join(inspect_deck(changed, expected, 1e-9))


def test_an_operating_point_of_another_circuit_raises_input_error() -> None:
    netlist = random_grid(3)
    other = netlist.replace(conductance=2.0 * netlist.conductance)
    with pytest.raises(rg.InputError, match="another netlist; solve this one first"):
        expect(flatten(other), rg.solve(netlist))


def test_every_changed_resistor_is_found_without_the_hash(original: Path) -> None:
    expected = read_sidecar(original).expected
    text = original.read_text()
    assert inspect_deck(text.encode(), expected, 1e-9) == []
    rows = text.split("\n")
    for number, line in enumerate(rows):
        if line.startswith("r_"):
            name, first, second, value = line.split()
            changed = [*rows[:number], f"{name} {first} {second} {1.01 * float(value)!r}", *rows[number + 1 :]]
            findings = inspect_deck("\n".join(changed).encode(), expected, 1e-9)
            # The two ends of the changed resistor are reported, unless they are rails.
            assert findings, line
            assert all(f"node {first} " in finding or f"node {second} " in finding for finding in findings)
            assert str(number + 1) in findings[0]


def test_an_adapted_hash_does_not_hide_a_change(deck: Path) -> None:
    import hashlib

    rows = lines_of(deck)
    number = next(i for i, line in enumerate(rows) if line.startswith("r_node_10_"))
    name, first, second, value = rows[number].split()
    rows[number] = f"{name} {first} {second} {1.01 * float(value)!r}"
    deck.write_text("\n".join(rows))
    sidecar = deck.with_name("grid.cir.json")
    content = json.loads(sidecar.read_text())
    content["sha256"] = hashlib.sha256(deck.read_bytes()).hexdigest()
    sidecar.write_text(json.dumps(content))
    agreement = rg.check_deck(deck)
    assert not agreement.agrees
    assert any(f"node {first} " in finding and str(number + 1) in finding for finding in agreement.findings)
    assert any(finding.startswith("node ") and "ngspice finds" in finding for finding in agreement.findings)


def test_a_floating_node_is_named(deck: Path) -> None:
    rows = [line for line in lines_of(deck) if not (line.startswith("r_") and "node_20" in line.split()[1:3])]
    deck.write_text("\n".join(rows).replace("i_node_20 ", "* i_node_20 "))
    findings = rg.check_deck(deck).findings
    assert any("node node_20 has no element" in finding for finding in findings)
    assert any("absent from the simulation: node_20" in finding for finding in findings)


def test_an_added_island_is_named(deck: Path) -> None:
    deck.write_text(deck.read_text().replace(".end", "r_x x y 1000.0\n.end"))
    findings = "\n".join(rg.check_deck(deck).findings)
    assert "names the node x, which has no expected voltage" in findings
    assert "singular" in findings
    assert "simulated but not expected: x, y" in findings


def test_a_deck_with_commands_fails_without_execution(deck: Path) -> None:
    deck.write_text(deck.read_text().replace(".end", f".control\nshell touch {deck.parent}/ran\n.endc\n.end"))
    agreement = rg.check_deck(deck)
    assert not agreement.agrees
    assert agreement.nodes == 0
    assert agreement.max_abs_error is None
    assert any("'.control' is not simulated" in finding for finding in agreement.findings)
    assert not (deck.parent / "ran").exists()


def test_a_reference_agrees_with_its_own_deck_only(deck: Path) -> None:
    own = rg.check_deck(deck, reference=dense_solution(random_grid(3)))
    assert own.findings == ()
    assert own.reference == "scene"
    deck.with_name("grid.cir.json").unlink()
    assert rg.check_deck(deck, reference=dense_solution(random_grid(3))).agrees
    other = rg.check_deck(deck, reference=dense_solution(random_grid(4)))
    assert not other.agrees
    assert other.worst


def test_nan_is_the_largest_difference() -> None:
    flat = flatten(ladder(2))
    expected = expect(flat, dense_solution(ladder(2)))
    good = SimulatorRun(expected.voltage, {"v_node_1": expected.source_current["v_node_1"] or 0.0}, "x", "1", ())
    assert compare(expected, good).agrees
    for value in (float("nan"), float("inf")):
        bad = replace(good, voltage={**expected.voltage, "node_2": value})
        agreement = compare(expected, bad)
        assert not agreement.agrees
        assert agreement.max_abs_error is None
        assert agreement.worst[0][0] == "node_2"
    current = replace(good, source_current={"v_node_1": -1.0})
    assert "voltage source v_node_1" in compare(expected, current).findings[0]
    assert not compare(expected, replace(good, complaints=("Warning",))).agrees
    assert not compare(expected, replace(good, voltage={})).agrees


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (b"{", "Invalid JSON"),
        (b"[]", "should be an object"),
        (b'{"schema": 2}', "schema: Input should be 1"),
        (b"[" * 100_000, "Invalid JSON"),
        (b"\xff\xfe", "Invalid JSON"),
        ({"sha256": 5}, "sha256"),
        ({"supply": 0}, "supply"),
        ({"supply": 10**400}, "supply"),
        ({"nodes": {"a": {"voltage": None}}}, r"nodes\.a\.voltage"),
        ({"nodes": {"a": 3}}, r"nodes\.a: Input should be an object;"),
        ({"blocks": {"lines": 0, "sha256": []}}, "blocks"),
        ({"dialect": "verilog"}, "choose one of"),
    ],
)
def test_a_damaged_sidecar_raises_input_error(deck: Path, change: object, message: str) -> None:
    sidecar = deck.with_name("grid.cir.json")
    content = json.loads(sidecar.read_text())
    sidecar.unlink()
    if isinstance(change, bytes):
        sidecar.write_bytes(change)
    elif isinstance(change, dict):
        sidecar.write_text(json.dumps(content | change))
    with pytest.raises(rg.InputError, match=message):
        rg.check_deck(deck)


def test_a_changed_voltage_in_the_sidecar_fails_the_check(deck: Path) -> None:
    sidecar = deck.with_name("grid.cir.json")
    content = json.loads(sidecar.read_text())
    content["nodes"]["node_12"]["voltage"] += 1e-6
    sidecar.write_text(json.dumps(content))
    agreement = rg.check_deck(deck)
    assert not agreement.agrees
    assert agreement.worst[0][0] == "node_12"


@pytest.mark.parametrize("tolerance", [0.0, -1.0, float("nan"), 2.0])
def test_a_tolerance_out_of_range_raises_input_error(deck: Path, tolerance: float) -> None:
    with pytest.raises(rg.InputError, match="tolerance"):
        rg.check_deck(deck, tolerance=tolerance)


def test_a_missing_simulator_raises_tool_missing_error(deck: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RESGRID_NGSPICE", "no-such-program")
    with pytest.raises(rg.ToolMissingError):
        rg.check_deck(deck)


@pytest.mark.parametrize(("version", "known"), [("39", True), ("46", True), ("44.2", False), ("unknown", False)])
def test_an_untested_version_of_the_simulator_is_reported(version: str, known: bool) -> None:
    expected = expect(flatten(ladder(2)), dense_solution(ladder(2)))
    current = {name: amps or 0.0 for name, amps in expected.source_current.items()}
    agreement = compare(expected, SimulatorRun(expected.voltage, current, "ngspice", version, ()))
    assert agreement.agrees and agreement.verified
    assert (agreement.remark == "") == known and (known or version in agreement.remark)


BOUNDARIES = [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 1e5}]


@pytest.mark.slow
@settings(max_examples=30, suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow])
@given(spaces(), st.sampled_from(BOUNDARIES))
def test_ngspice_agrees_on_random_spaces(space: rg.ConfigurationSpace, options: dict[str, object]) -> None:
    try:
        netlist = rg.compile_space(space, **options)
        point = rg.solve(netlist)
    except rg.CircuitError:
        assume(False)
    if options.get("boundary") == "neumann":
        netlist = rg.normalize_drive(netlist, point)
        point = rg.solve(netlist)
    agreement = rg.check_deck(point)
    assert agreement.agrees, agreement.findings
    assert agreement.max_relative_error < 1e-9


def test_the_sidecar_contains_the_supply_of_a_saturating_chip(tmp_path: Path) -> None:
    cell = np.zeros((5, 5), dtype=np.uint8)
    cell[1, 1], cell[3, 3] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    netlist = rg.compile_space(space_of(cell), rails="cells", supply=5.0)
    chip = rg.chip.build_chip(netlist, [rg.chip.effects.RailSwitches(goal_on=10.0), rg.chip.effects.Saturation(2.0)])
    written = rg.write_spice(rg.solve(chip), tmp_path / "chip.cir")
    assert read_sidecar(written.path).supply == pytest.approx(5.0, rel=0.1)
    assert rg.check_deck(written.path).agrees


def test_a_simulation_without_operating_point_is_not_verified() -> None:
    op = dense_solution(random_grid(3))
    expected = expect(flatten(op.netlist), op)
    silent = SimulatorRun({}, {}, "ngspice", "39", ("no convergence",))
    agreement = compare(expected, silent)
    assert agreement.agrees is None and not agreement.verified
    assert "no operating point" in agreement.remark
    changed = compare(expected, silent, findings=["line 3 was changed"])
    assert changed.agrees is False and not changed.verified and "no operating point" in changed.remark


def test_streams_and_networks_are_checked_as_read_but_not_verified(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a ground 1000\n")
    (tmp_path / "amps.txt").write_text("a 1e-3\n")
    network = rg.read_spice(tmp_path / "a.csv", sources=tmp_path / "amps.txt")
    stream = rg.read_spice(io.StringIO("t\nv1 a 0 1\nr1 a 0 1k\n"))
    for circuit, why in ((network, "it is not a deck"), (stream, "the file <text> does not exist")):
        agreement = rg.check_deck(circuit)
        assert not agreement.verified and why in agreement.remark
        assert agreement.as_read is not None and agreement.as_read.agrees


def test_a_deck_that_ngspice_does_not_run_is_not_verified(tmp_path: Path) -> None:
    deck = tmp_path / "step.cir"
    sweep = ".param p=1k\n.step param p 1k 2k 1k\n"
    deck.write_text(f"* a sweep\nV1 in 0 1\n{sweep}R1 in a {{p}}\nR2 a 0 1k\n.end\n")
    agreement = rg.check_deck(deck)
    assert not agreement.verified and agreement.agrees is not True
    assert any("wrote no raw file" in finding for finding in agreement.findings)
