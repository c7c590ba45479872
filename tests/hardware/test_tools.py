"""Outside programs: where they are found, and messages for absent, old, failing and slow programs.

Tests internals: `resgrid.hardware.tools`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import resgrid as rg
from resgrid.hardware import tools
from resgrid.hardware.tools import KicadCli, KlayoutPython, find_kicad, find_klayout


def program(path: Path, body: str) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return path


@pytest.fixture(autouse=True)
def no_programs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.delenv(tools.KICAD_VARIABLE, raising=False)
    monkeypatch.delenv(tools.KLAYOUT_VARIABLE, raising=False)
    monkeypatch.setattr(tools, "_UNPACKED", tmp_path / "checkout" / "kicad-cli")


def test_kicad_is_found_by_variable_then_on_path_then_unpacked(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:  # fmt: skip
    unpacked = program(tmp_path / "checkout" / "kicad-cli", "echo 9.0.8")
    assert find_kicad() == KicadCli(str(unpacked), "9.0.8")
    old = program(tmp_path / "bin" / "kicad-cli", "echo 7.0.11")
    assert find_kicad().program == str(unpacked)
    unpacked.unlink()
    with pytest.raises(rg.ToolMissingError, match=r"kicad-cli has version 7\.0\.11, and 9 is needed"):
        find_kicad()
    program(old, "echo 10.0.1")
    assert find_kicad() == KicadCli(str(old), "10.0.1")
    named = program(tmp_path / "named" / "kicad", "echo 9.1.0-rc1")
    monkeypatch.setenv(tools.KICAD_VARIABLE, str(named))
    assert find_kicad() == KicadCli(str(named), "9.1.0-rc1")


@pytest.mark.parametrize("named", ["", "/nowhere/kicad-cli"])
def test_without_kicad_the_message_names_the_ways_to_get_it(monkeypatch: pytest.MonkeyPatch, named: str) -> None:
    monkeypatch.setenv(tools.KICAD_VARIABLE, named)
    with pytest.raises(rg.ToolMissingError) as caught:
        find_kicad()
    for words in ("scripts/unpack_kicad.sh .venv-kicad", "install KiCad 9", tools.KICAD_VARIABLE, named):
        assert words in str(caught.value)


def test_a_failing_program_is_quoted(tmp_path: Path) -> None:
    kicad = KicadCli(str(program(tmp_path / "bin" / "kicad-cli", "echo Failed to load board >&2; exit 3")), "9")
    with pytest.raises(rg.InputError, match=r"'kicad-cli pcb drc' failed for a\.kicad_pcb: Failed to load board"):
        kicad.run("pcb", "drc", "a.kicad_pcb")


def test_a_slow_program_is_ended(tmp_path: Path) -> None:
    kicad = KicadCli(str(program(tmp_path / "bin" / "kicad-cli", "exec /bin/sleep 60")), "9")
    with pytest.raises(rg.BudgetError, match=r"kicad-cli did not finish within 0\.2 s"):
        kicad.run("pcb", "drc", "a.kicad_pcb", timeout=0.2)


def test_settings_of_the_user_have_no_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KICAD_CONFIG_HOME", "/mine")
    kicad = KicadCli(str(program(tmp_path / "bin" / "kicad-cli", "echo $KICAD_CONFIG_HOME")), "9")
    assert "/mine" not in kicad.run("version")


def test_klayout_runs_as_a_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_klayout().program == sys.executable
    script = tmp_path / "script.py"
    script.write_text("import sys, klayout.db as db\nprint(db.Layout().dbu, sys.argv[1])\n")
    assert find_klayout().run(script, "x") == "0.001 x\n"
    assert "klayout" not in sys.modules
    script.write_text("raise SystemExit('no layer 7')\n")
    with pytest.raises(rg.InputError, match=r"klayout cannot extract a\.gds: no layer 7"):
        find_klayout().run(script, "a.gds")
    named = program(tmp_path / "bin" / "python", "echo 0.30.1")
    monkeypatch.setenv(tools.KLAYOUT_VARIABLE, str(named))
    assert find_klayout() == KlayoutPython(str(named), "0.30.1")
    program(named, "exit 1")
    with pytest.raises(rg.ToolMissingError, match=r"is not a Python with klayout: .* pip install klayout"):
        find_klayout()
