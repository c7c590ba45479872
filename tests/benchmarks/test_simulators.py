"""Simulators found by the benchmarks, and the option that selects their fastest solver."""

from pathlib import Path

import pytest

from benchmarks import simulators


def fake_simulator(path: Path, said: str) -> Path:
    path.write_text(f"#!/bin/sh\necho '{said}'\n")
    path.chmod(0o755)
    return path


def test_the_newest_simulator_is_last_and_uses_klu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        simulators, "UNPACKED", fake_simulator(tmp_path / "new", "** ngspice-46 **\n** Compiled with KLU")
    )
    monkeypatch.setenv("RESGRID_NGSPICE", str(fake_simulator(tmp_path / "old", "** ngspice-39 **")))
    old, new = simulators.simulators()
    assert (old.name, new.name) == ("ngspice 39, Sparse 1.3", "ngspice 46, KLU")
    assert old.with_cards("* deck\n.op\n.end\n") == "* deck\n.op\n.end\n"
    assert new.with_cards("* deck\n.op\n.end\n") == "* deck\n.op\n.options klu\n.end\n"


def test_without_simulators_the_list_is_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulators, "UNPACKED", tmp_path / "none")
    monkeypatch.setenv("RESGRID_NGSPICE", str(tmp_path / "none"))
    assert simulators.simulators() == []
