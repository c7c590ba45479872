"""Runs of ngspice: signs, complaints, refusal of commands, time limits, interrupts, and environment.

Tests internals: `resgrid.spice.run.ngspice`, `resgrid.spice.write.flat`.
"""

from __future__ import annotations

import os
import re
import signal
import stat
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from support.circuits import ladder
from support.spaces import space_of

import resgrid as rg
from resgrid.spice.run.ngspice import simulate
from resgrid.spice.write.flat import flatten

FLOATING = b"* floating\nv_a a 0 1.0\nr_a_b a b 1e8\nr_b b 0 1e8\nr_x_y x y 1e8\n.end\n"


def program(folder: Path, body: str) -> Path:
    """Write a substitute program for ngspice."""
    path = folder / "fake"
    path.write_text(f"#!{sys.executable}\nimport sys, time, pathlib\n{body}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_a_current_source_injects_into_its_second_node(tmp_path: Path) -> None:
    deck = tmp_path / "a deck.cir"
    deck.write_text("* signs\nv_a a 0 1.0\ni_b 0 b 1e-05\nr_a_b a b 10000.0\nr_b b 0 10000.0\n.end\n")
    simulation = simulate(deck.read_bytes())
    assert simulation.complaints == ()
    assert simulation.voltage == pytest.approx({"a": 1.0, "b": 0.55}, abs=1e-15)
    assert simulation.source_current == pytest.approx({"v_a": -4.5e-5}, abs=1e-18)
    assert simulation.version[0].isdigit()


@pytest.mark.parametrize("name", ["time", "frequency", "temp-sweep", "onoise_spectrum"])
def test_nodes_with_the_names_of_other_quantities_are_compared(tmp_path: Path, name: str) -> None:
    deck = tmp_path / "deck.cir"
    deck.write_text(f"title\nV1 in 0 1\nR1 in {name} 1k\nR2 {name} 0 3k\n.end\n")
    agreement = rg.check_deck(deck)
    assert (agreement.agrees, agreement.nodes) == (True, 2)
    deck.write_text(f"title\nI1 0 {name} 1\nR1 0 {name} 2\n.end\n")
    assert rg.check_deck(deck).agrees


def test_temperature_coefficients_have_no_effect_at_the_nominal_one() -> None:
    netlist = ladder(2).replace(tc1=[1e-2, 0, 0], tc2=[1e-4, 0, 0])
    assert simulate(flatten(netlist).text.encode()).voltage == simulate(flatten(ladder(2)).text.encode()).voltage


@pytest.mark.parametrize("volts", [0.2, 0.03])
def test_gmin_stepping_of_saturated_chips_is_not_a_complaint(volts: float) -> None:
    """ngspice reduces gmin stepwise to zero; floating nodes are detected by its other messages."""
    cell = np.zeros((3, 3), dtype=np.uint8)
    cell[1, 1], cell[2, 2] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    chip = rg.Chip(saturation_voltage=volts, readout=rg.chip.Readout(input_resistance=1e6))
    agreement = rg.check_deck(rg.study(space_of(cell), chip, boundary="neumann").op)
    assert agreement.findings == ()
    assert agreement.agrees


def test_a_floating_node_is_reported_as_singular_matrix() -> None:
    simulation = simulate(FLOATING)
    assert any("singular matrix" in line for line in simulation.complaints)
    assert abs(simulation.voltage["b"] - 0.5) > 1e-6  # wrong, although the exit status is 0


@pytest.mark.parametrize(
    ("deck", "message"),
    [
        (b"* a\nv_a a 0 1.0\nv_b a 0 1.0\nr_a a 0 1.0\n.end\n", "singular"),
        (b"* a\nv_a a 0 1.0\nr_a a 0 1.0\nq_a a 0 1.0\n.end\n", "could not find"),
        (b"* a\nv_a a 0 1.0\nr_a a 0 1.0\nr_a a 0 1.0\n.end\n", "already exists"),
        (b"", "found no node"),
        (b"\x00\xff\n" * 50, "found no node"),
    ],
)
def test_a_broken_deck_causes_a_complaint(deck: bytes, message: str) -> None:
    simulation = simulate(deck)
    assert re.search(message, "\n".join(simulation.complaints))


@pytest.mark.parametrize(
    "line",
    [
        b".control",
        b"  .CONTROL",
        b"*#quit",
        b".include /etc/passwd",
        b".incl /etc/passwd",
        b".lib x",
        b"\r.control",
        b"\x0b.inc x",
        b".controlled",
        b".con\rtrol",
        b"*ng_script",
    ],
)
def test_a_deck_with_commands_raises_input_error(line: bytes) -> None:
    for direct in (False, True):
        with pytest.raises(rg.InputError, match=r"line [23].*is not simulated"):
            simulate(b"* a\n" + line + b"\n.end\n", direct=direct)


def test_scripts_and_code_models_raise_input_error() -> None:
    for deck in (b"*ng_script\nshell ls\n", b"\xef\xbb\xbf.control\n", b"t\n.end\n a1 [b] [c] m\n"):
        with pytest.raises(rg.InputError, match="is not simulated"):
            simulate(deck, direct=True)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("print('all is well'); sys.exit(0)", r"wrote no raw file \(exit status 0\)"),
        ("sys.exit(1)", r"wrote no raw file \(exit status 1\)"),
        ("pathlib.Path('operating_point.raw').write_bytes(bytes(range(256)))", "ends before its data"),
        ("pathlib.Path('operating_point.raw').mkdir()", "wrote no raw file"),
    ],
)
def test_a_missing_or_invalid_raw_file_is_a_complaint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, message: str
) -> None:
    monkeypatch.setenv("RESGRID_NGSPICE", str(program(tmp_path, body)))
    simulation = simulate(FLOATING)
    assert simulation.voltage == {}
    assert simulation.version == "unknown"
    assert re.search(message, "\n".join(simulation.complaints))


def test_a_hanging_simulator_is_terminated_after_the_timeout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pid = tmp_path / "pid"
    hang = program(
        tmp_path,
        "import os\nif '--version' in sys.argv: sys.exit()\n"
        f"pathlib.Path({str(pid)!r}).write_text(str(os.getpid()))\ntime.sleep(600)",
    )
    monkeypatch.setenv("RESGRID_NGSPICE", str(hang))
    for patience in (1.0, 4.0, 16.0, 64.0):  # on a busy computer the start alone may take more than a second
        with pytest.raises(rg.BudgetError, match=f"did not finish deck within {patience:g} s"):
            simulate(FLOATING, timeout=patience)
        if pid.exists() and pid.read_text():
            break
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


@pytest.mark.skipif(sys.platform != "linux", reason="another process is limited on Linux only")
def test_the_simulator_has_a_cpu_time_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit = tmp_path / "limit"
    wait = (
        "import resource\n"
        "while resource.getrlimit(resource.RLIMIT_CPU)[1] == resource.RLIM_INFINITY: time.sleep(0.01)\n"
        f"pathlib.Path({str(limit)!r}).write_text(str(resource.getrlimit(resource.RLIMIT_CPU)))"
    )
    body = f"if '--version' not in sys.argv:\n    exec({wait!r})"
    monkeypatch.setenv("RESGRID_NGSPICE", str(program(tmp_path, body)))
    simulate(FLOATING, timeout=90.5)
    assert limit.read_text() == "(92, 92)"


def test_an_interrupt_terminates_the_simulator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pid = tmp_path / "pid"
    hang = program(
        tmp_path,
        "import os\nif '--version' in sys.argv: sys.exit()\n"
        f"pathlib.Path({str(pid)!r}).write_text(str(os.getpid()))\ntime.sleep(60)",
    )

    monkeypatch.setenv("RESGRID_NGSPICE", str(hang))

    def interrupt_when_running() -> None:
        while not (pid.exists() and pid.read_text()):
            time.sleep(0.01)
        signal.raise_signal(signal.SIGINT)

    threading.Thread(target=interrupt_when_running, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        simulate(FLOATING)
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


def test_a_missing_ngspice_raises_tool_missing_error(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("/nowhere/ngspice", "no-such-program"):
        monkeypatch.setenv("RESGRID_NGSPICE", name)
        with pytest.raises(rg.ToolMissingError, match=f"{name}.*apt-get install ngspice"):
            simulate(FLOATING)


def test_user_settings_have_no_effect_on_the_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / ".spiceinit").write_text("set filetype=ascii\nquit\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SPICE_ASCIIRAWFILE", "1")
    assert simulate(flatten(ladder()).text.encode()).complaints == ()


@pytest.mark.parametrize(("name", "says"), [("missing.cir", "no such file"), (".", "directory"), ("a\0b", "null")])
def test_an_unreadable_deck_raises_input_error(tmp_path: Path, name: str, says: str) -> None:
    with pytest.raises(rg.InputError, match=says):
        rg.check_deck(f"{tmp_path}/{name}")
