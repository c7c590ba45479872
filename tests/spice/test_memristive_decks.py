"""Decks with memristors: their transients in ngspice, altered files, other dialects, and clear messages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.cli import call
from support.grammar import strangers
from support.memristors import LAW, loop, random_memristive
from support.simulators import run, waves
from support.spaces import space_of

import resgrid as rg


def grid(law: rg.circuit.Memristor | None = None) -> rg.circuit.MemristiveCircuit:
    """Return a grid of 4 x 3 cells whose links are antiparallel memristors."""
    cell = np.zeros((4, 3), dtype=np.uint8)
    cell[1, 1], cell[3, 2] = 1, 2
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(0, 0), resistance=1e3)
    law = rg.circuit.Memristor(1e3, 1e5, 1e6) if law is None else law
    return rg.circuit.MemristiveCircuit.antiparallel(netlist, law)


def test_the_difference_from_ngspice_falls_with_its_tolerance(tmp_path: Path) -> None:
    error = []
    for reltol in (1e-4, 1e-6, 1e-9):
        rg.spice.write_memristive(grid(), tmp_path / "grid.cir", stop=0.2, step=0.01, reltol=reltol)
        agreement = rg.check_deck(tmp_path / "grid.cir")
        assert agreement.verified and agreement.simulator == "ngspice" and agreement.nodes == 11
        error.append(agreement.max_relative_error)
    assert error[0] > 5 * error[1] > 25 * error[2] and error[2] < 1e-4  # 1e-2, 8e-4 and 7e-6 with ngspice 39
    assert agreement.agrees, agreement.findings


@pytest.mark.parametrize(
    ("circuit", "waveform"),
    [
        (rg.circuit.MemristiveCircuit.antiparallel(loop(), LAW), [[0.0, 0.0], [0.5, 2.0], [1.0, -2.0]]),
        (grid(rg.circuit.Memristor(1e3, 1e5, 1e6, "joglekar", 3, initial=0.2)), None),
        (random_memristive(3, capacitors=True), None),
        (random_memristive(5), [[0.1, 1.0], [0.2, -1.0]]),
    ],
    ids=["reversal", "joglekar", "capacitors", "current source"],
)
@pytest.mark.quick_cases(2)
def test_ngspice_agrees_on_windows_waveforms_and_capacitors(
    tmp_path: Path, circuit: rg.circuit.MemristiveCircuit, waveform: object
) -> None:
    rg.spice.write_memristive(circuit, tmp_path / "a.cir", stop=0.7, waveform=waveform)
    agreement = rg.check_deck(tmp_path / "a.cir")
    assert agreement.agrees, agreement.findings
    assert agreement.max_relative_error < 1e-3


def test_the_deck_runs_by_itself_and_holds_no_commands(tmp_path: Path) -> None:
    written = rg.spice.write_memristive(rg.circuit.MemristiveCircuit(loop(), LAW), tmp_path / "one.cir", stop=0.5)
    text = written.path.read_text()
    assert not [line for line in text.splitlines() if line.startswith(".") and line != ".end"]
    run(written.commands)
    found = waves(tmp_path / "out.raw", "Transient")
    expected = rg.circuit.memristive_transient(rg.circuit.MemristiveCircuit(loop(), LAW), found["time"])
    assert np.abs(np.array(found["x_node_1"]) - expected.state[:, 0]).max() < 1e-5
    again = rg.spice.write_memristive(rg.circuit.MemristiveCircuit(loop(), LAW), tmp_path / "two.cir", stop=0.5)
    assert again.path.read_text() == text and again.sha256 == written.sha256


@pytest.mark.parametrize("name", ["a.cir", "a.cir.ngspice", "a.cir.json"])
def test_every_altered_file_is_reported(tmp_path: Path, name: str) -> None:
    rg.spice.write_memristive(rg.circuit.MemristiveCircuit(loop(), LAW), tmp_path / "a.cir", stop=0.5)
    file = tmp_path / name
    file.write_text(file.read_text().replace("0.5", "0.50").replace("16000.0", "16100.0"))
    agreement = rg.check_deck(tmp_path / "a.cir")
    assert agreement.agrees is False
    assert any(message.startswith(f"{name} differs from what resgrid wrote") for message in agreement.findings)
    if name == "a.cir":
        assert any("ngspice finds" in message for message in agreement.findings)


def test_the_command_line_checks_the_transient(tmp_path: Path) -> None:
    rg.spice.write_memristive(grid(), tmp_path / "grid.cir", stop=0.2)
    result = call("check", "--json", tmp_path / "grid.cir")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["agrees"] and found["verified"] and found["reference"] == "sidecar"
    broken = (tmp_path / "grid.cir").read_text().replace("100000.0-", "90000.0-", 1)
    (tmp_path / "grid.cir").write_text(broken)
    assert call("check", tmp_path / "grid.cir").exit_code == 1


def test_a_simulation_that_fails_is_not_an_agreement(tmp_path: Path) -> None:
    rg.spice.write_memristive(grid(), tmp_path / "grid.cir", stop=0.2)
    (tmp_path / "grid.cir").write_text("* nothing\n.end\n")
    agreement = rg.check_deck(tmp_path / "grid.cir")
    assert not agreement.agrees and agreement.findings


@pytest.mark.parametrize("dialect", ["ltspice", "xyce", "hspice", "spectre"])
@pytest.mark.quick_cases(1)
def test_other_dialects_are_written_but_not_run(tmp_path: Path, dialect: str) -> None:
    law = rg.circuit.Memristor(1e3, 1e5, 1e6, "joglekar", 2, initial=0.2)
    for circuit in (grid(), grid(law), random_memristive(3, capacitors=True)):
        written = rg.spice.write_memristive(
            circuit, tmp_path / "a.cir", stop=0.1, dialect=dialect, waveform=[[0, 1], [1, 2]]
        )
        if dialect in ("xyce", "spectre"):
            assert strangers(written.path.read_text() + written.commands.read_text(), dialect) == []
        with pytest.raises(rg.InputError, match=f"written for {dialect}, and only ngspice is run"):
            rg.check_deck(written.path)


@pytest.mark.parametrize("dialect", ["ltspice", "hspice"])
def test_ngspice_reads_other_dialects_in_its_compatibility_modes(tmp_path: Path, dialect: str) -> None:
    circuit = grid()
    written = rg.spice.write_memristive(circuit, tmp_path / "a.cir", stop=0.1, dialect=dialect)
    run(written.commands, dialect)
    found = waves(tmp_path / "out.raw", "Transient")
    end = rg.circuit.memristive_transient(circuit, [0.1])
    states = [found[name][-1] for name in json.loads(written.sidecar.read_text())["states"]]
    assert sorted(states) == pytest.approx(sorted(end.state[-1]), abs=1e-3)


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "xyce", "hspice", "spectre"])
def test_a_deck_without_its_sidecar_is_not_read_as_resistors(tmp_path: Path, dialect: str) -> None:
    written = rg.spice.write_memristive(
        rg.circuit.MemristiveCircuit(loop(), LAW), tmp_path / "a.cir", stop=1.0, dialect=dialect
    )
    written.sidecar.unlink()
    with pytest.raises(rg.InputError, match="belongs to a memristor, whose resistance depends on its history"):
        rg.read_spice(written.path, dialect=dialect)


def test_bad_input_is_one_clear_message(tmp_path: Path) -> None:
    circuit, file = rg.circuit.MemristiveCircuit(loop(), LAW), tmp_path / "a.cir"
    with pytest.raises(rg.InputError, match="stop = 0 "):
        rg.spice.write_memristive(circuit, file, stop=0)
    with pytest.raises(rg.InputError, match="step = 2 s must be at most stop = 1 s"):
        rg.spice.write_memristive(circuit, file, stop=1.0, step=2.0)
    with pytest.raises(rg.InputError, match="reltol = 1 must be below 1"):
        rg.spice.write_memristive(circuit, file, stop=1.0, reltol=1)
    with pytest.raises(rg.InputError, match="no SPICE dialect 'spice'"):
        rg.spice.write_memristive(circuit, file, stop=1.0, dialect="spice")
    assert not list(tmp_path.iterdir())
    written = rg.spice.write_memristive(circuit, file, stop=1.0)
    with pytest.raises(rg.InputError, match="leave out reference"):
        rg.check_deck(file, reference=rg.solve(circuit.netlist))
    with pytest.raises(rg.InputError, match="runs operating points only"):
        rg.check_deck(file, engine="eecircuit")
    text = written.sidecar.read_text()
    written.sidecar.write_text(text.replace('"supply": 1.0', '"supply": -1.0'))
    with pytest.raises(rg.InputError, match="is damaged"):
        rg.check_deck(file)
    written.sidecar.write_text(text)
    written.commands.unlink()
    with pytest.raises(rg.InputError, match=r"a.cir.ngspice is missing, which requests the transient"):
        rg.check_deck(file)
