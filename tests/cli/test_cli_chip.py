"""The report of resgrid chip: figures and pages, and its decks run unchanged in ngspice."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from support.cli import COMMAND, call
from support.simulators import run, verdict, waves

QUICK = ["--most", 64, "--half-width", 0.02, "--seconds", 1]
CHIPS = {
    "linear": [],
    "saturating": ["--set", "chip.saturation_voltage=0.5", "--only", "settling,noise"],
}


def report(scene: Path, folder: Path, *words: object) -> Path:
    result = call("chip", scene, "-o", folder, "-q", *words)
    assert result.exit_code == 0, result.stderr
    return folder


@pytest.fixture(scope="module", params=CHIPS)
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, scenes: Path) -> Path:
    where = tmp_path_factory.mktemp("chip") / request.param
    return report(scenes / "chip.toml", where, *QUICK, *CHIPS[request.param])


def expected(folder: Path, name: str) -> dict:
    return json.loads((folder / f"{name}.cir.json").read_text())["expected"]


def simulated(folder: Path, name: str, tmp_path: Path) -> dict[str, np.ndarray]:
    for file in folder.glob(f"{name}.cir*"):
        shutil.copy(file, tmp_path / file.name)
    run(tmp_path / f"{name}.cir.ngspice")
    return {key: np.array(values) for key, values in waves(tmp_path / "out.raw").items()}


@pytest.mark.slow
def test_the_operating_point_agrees_with_ngspice(folder: Path) -> None:
    for name in ("op", "noise", "temperature"):
        assert verdict(folder / f"{name}.cir.verify") == (0, "PASS")  # 1e-9 of the supply
    assert re.search(r"ngspice \S+ agrees with op.cir", (folder / "report.md").read_text())


@pytest.mark.slow
def test_the_transient_agrees_with_ngspice(folder: Path, tmp_path: Path) -> None:
    if folder.name == "saturating":  # its deck is the small-signal circuit, which is linear, too
        return
    wanted = expected(folder, "transient")
    found = simulated(folder, "transient", tmp_path)
    clock, supply = found["time"], 1.8
    assert len(wanted["times"]) == 10
    assert len(wanted["voltage"]) == 256
    for name, volts in wanted["voltage"].items():
        assert np.abs(np.interp(wanted["times"], clock, found[name]) - volts).max() < 1e-3 * supply
    # The weighted distance from the final voltages is a single exponential at all times.
    distance = sum(weight * (found[name] - wanted["final"][name]) for name, weight in wanted["weight"].items())
    tau = wanted["slowest_time_constant"]
    part = (clock > 0.3 * tau) & (clock < 4.0 * tau)
    slope = np.polyfit(clock[part], np.log(np.abs(distance[part])), 1)[0]
    assert -1.0 / slope == pytest.approx(tau, rel=1e-3)


@pytest.mark.slow
def test_the_noise_agrees_with_ngspice(folder: Path, tmp_path: Path) -> None:
    wanted = expected(folder, "noise")
    found = simulated(folder, "noise", tmp_path)
    frequency, density = found["frequency"], found["onoise_spectrum"]
    assert (frequency[0], frequency[-1]) == pytest.approx(wanted["band"], rel=1e-6)
    power = density**2 * frequency
    total = np.sqrt(np.sum((power[1:] + power[:-1]) / 2 * np.diff(np.log(frequency))))
    assert wanted["total"] == pytest.approx(total, rel=1e-3)
    assert wanted["density"] == pytest.approx(density[0], rel=1e-3)
    data = json.loads((folder / "summary.json").read_text())["analyses"]["settling"]
    assert wanted["band"][1] >= 99 / (2 * np.pi * data["fastest_time_constant"]["value"])
    assert wanted["limit"] == pytest.approx(np.sqrt(1.380649e-23 * 300.15 / 60e-15), rel=1e-9)


@pytest.mark.slow
def test_voltages_at_all_temperatures_agree_with_ngspice(folder: Path, tmp_path: Path) -> None:
    for file in folder.glob("temperature.cir*"):
        shutil.copy(file, tmp_path / file.name)
    run(tmp_path / "temperature.cir.ngspice")
    wanted = expected(folder, "temperature")["voltage"]
    assert set(wanted) == {"-40.0", "27.0", "60.0", "85.0", "125.0"}
    for celsius, voltages in wanted.items():
        found = waves(tmp_path / f"celsius.raw.{celsius}")
        for name, volts in voltages.items():
            assert found[name][0] == pytest.approx(volts, rel=0, abs=1e-9 * 1.8)
    if folder.name == "linear":
        assert wanted["-40.0"] != wanted["125.0"]


@pytest.mark.slow
def test_the_report_lists_every_figure_with_its_definition(folder: Path) -> None:
    text = (folder / "report.md").read_text()
    data = json.loads((folder / "summary.json").read_text(), parse_constant=pytest.fail)
    assert set(data["files"]) == {file.name for file in folder.iterdir()}
    page = (folder / "report.html").read_text()
    for name, analysis in data["analyses"].items():
        assert f"## {name.replace('_', ' ').capitalize()}" in text
        for key, entry in analysis.items():
            if isinstance(entry, dict) and "definition" in entry:
                assert len(entry["definition"]) > 20
                assert f"| {key.replace('_', ' ')} |" in text
                assert f"<td>{key.replace('_', ' ')}</td>" in page
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", text):
        assert (folder / picture).stat().st_size > 5000
        assert f'src="{picture}"' in page
    assert "nan" not in text.lower()
    assert "`resistance` | 100 kΩ" in text


@pytest.mark.slow
def test_the_page_supports_small_screens_and_dark_mode(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    assert '<meta name="viewport" content="width=device-width' in page
    assert "@media (prefers-color-scheme: dark)" in page
    assert "max-width: 100%" in page


@pytest.mark.slow
def test_at_least_sets_exit_code_1_below_the_demanded_yield(answer, scenes: Path, tmp_path: Path) -> None:
    words = ("chip", scenes / "chip.toml", "-o", tmp_path / "out", "--only", "yield", *QUICK)
    data = answer(*words, "--at-least", 0.5)
    assert list(data["analyses"]) == ["yield"]
    assert 0.5 < data["analyses"]["yield"]["yield"]["value"] < 1.0
    assert answer(*words, "--at-least", 0.999, code=1)["analyses"] == data["analyses"]


def test_reports_of_chips_without_capacitance_and_of_three_axes_are_written(call, scenes: Path, tmp_path: Path) -> None:
    words = ["--set", "grid.cells=6", "--only", "settling,yield,adc_resolution", *QUICK, "--no-check"]
    result = call("chip", scenes / "lesson.toml", "-o", tmp_path / "flat", "--only", "settling,noise", "--no-check")
    assert result.exit_code == 0, result.stderr
    text = (tmp_path / "flat" / "report.md").read_text()
    assert text.count("Not analysed") == 4
    assert not (tmp_path / "flat" / "transient.cir").exists()
    del words[:2]
    axes = ["--set", "grid.axes.0.cells=6", "--set", "grid.axes.1.cells=6", "--set", "grid.axes.2.cells=6"]
    result = call("chip", scenes / "voxels.toml", "-o", tmp_path / "voxels", *axes, *words)
    assert result.exit_code == 0, result.stderr
    assert not list((tmp_path / "voxels").glob("yield.png"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--only", "yields"], "give names out of yield, yield_loss, adc_resolution"),
        (["--half-width", "0.7"], "0<x<0.5"),
        (["--most", "0"], "x>=1"),
        (["--sweep", "readout.bits=8,10"], "give --sweep twice"),
        (["--sweep", "readout.bits", "--sweep", "mismatch=1"], "expected KEY=VALUE"),
        (["--sweep", "readout.bit=8", "--sweep", "supply=1"], "did you mean 'readout.bits'"),
        (["--at-least", "2"], "0<=x<=1"),
        (["--set", "chip.readout.bits=0"], "bits"),
        (["--set", "chip.goal_switch_on=1T"], "goal_switch_on"),
        (["--set", "chip.width=-1"], "width"),
        (["-o", "-"], "name a folder"),
    ],
)
def test_invalid_chip_options_exit_with_2_and_a_message(
    call, scenes: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    only = [] if "--only" in words or "--sweep" in words else ["--only", "power"]
    only = ["--only", "sweep"] if "--sweep" in words else only
    folder = [] if "-o" in words else ["-o", tmp_path / "out"]
    result = call("chip", scenes / "chip.toml", *folder, *only, *words)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_killed_report_resumes_from_its_checkpoint(scenes: Path, tmp_path: Path) -> None:
    words = ["--only", "yield", "--half-width", "0.0005", "--most", "100000", "--no-check", "-q"]
    command = [*COMMAND, "chip", str(scenes / "chip.toml"), "-o", str(tmp_path / "out"), *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=dict(os.environ))
    while not any(b"\n" in file.read_bytes() for file in tmp_path.glob(".out-*.yield.jsonl")):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    (kept,) = tmp_path.glob(".out-*.yield.jsonl")  # found again by the next run: same scene, same seed
    assert kept.read_text().count("\n") >= 1
    assert not (tmp_path / "out").exists()
    folder = report(scenes / "chip.toml", tmp_path / "out", *words[:4], "--most", 256, "--no-check")
    again = report(scenes / "chip.toml", tmp_path / "again", *words[:4], "--most", 256, "--no-check")
    first, second = (json.loads((f / "summary.json").read_text())["analyses"] for f in (folder, again))
    assert first == second
    assert (folder / "yield.jsonl").read_bytes() == (again / "yield.jsonl").read_bytes()
    assert not list(tmp_path.glob(".*.jsonl"))
