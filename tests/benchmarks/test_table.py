"""The table, stored results and the picture of the benchmarks, compared with literals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import __main__ as benchmarks_main, grids, simulator, table
from benchmarks.picture import draw, panels, write_picture
from benchmarks.rows import RATIO, Row, Scale, Spread
from benchmarks.timing import alternating, repeated, spread

ROWS = [
    Row("64^3 neumann", 0.5, Spread(1.0, 1.0, 1.0), RATIO, note="multigrid, 5 runs"),
    Row("64^3 neumann", 2.25, Spread(4.5, 4.25, 5.125), RATIO, "PETSc GAMG + CG", "17 iterations, 5 runs"),
    Row("64^3 neumann", None, None, RATIO, "CHOLMOD (kvxopt)", "not done after 60 s"),
    Row("64^3 neumann: solve phase", 0.125, Spread(41.0, 40.0, 44.0), "products"),
]


def test_the_table_has_one_line_per_row_with_the_previous_value() -> None:
    lines = table.format_rows(ROWS, {("64^3 neumann", "PETSc GAMG + CG"): 6.0}).splitlines()
    words = [" ".join(line.split()) for line in lines]
    assert len(lines) == len(ROWS)
    assert words[1] == (
        "64^3 neumann PETSc GAMG + CG 2.25 s 4.50 4.25 .. 5.12 x resgrid (was 6.00) 17 iterations, 5 runs"
    )
    assert words[2] == "64^3 neumann CHOLMOD (kvxopt) - x resgrid not done after 60 s"
    assert table.format_rows([], {}) == ""


def test_stored_results_read_back_as_equal_rows(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    assert table.read_results(path) == {}
    table.write_results(path, {"volume": table.section_record(ROWS, Scale("full", seed=3))})
    sections = table.read_results(path)
    assert table.rows_of(sections["volume"]) == ROWS
    assert sections["volume"]["scale"] == "full"
    assert sections["volume"]["seed"] == 3
    assert table.last_values(sections)["64^3 neumann: solve phase", "resgrid"] == 41.0
    assert "NaN" not in path.read_text()


def test_results_of_another_schema_are_ignored(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(json.dumps({"schema": 1, "rows": []}))
    assert table.read_results(tmp_path / "results.json") == {}


def test_the_picture_has_one_panel_per_problem(tmp_path: Path) -> None:
    assert list(panels(ROWS)) == ["64^3 neumann"]
    figure = draw(ROWS)
    assert figure is not None
    ax = figure.axes[0]
    assert ax.get_xscale() == "log"
    assert [label.get_text() for label in ax.get_yticklabels()] == ["resgrid", "PETSc GAMG + CG", "CHOLMOD (kvxopt)"]
    assert "not done after 60 s" in [text.get_text() for text in ax.texts]
    assert write_picture(tmp_path / "results.png", {"volume": ROWS})
    assert (tmp_path / "results.png").read_bytes().startswith(b"\x89PNG")


def test_rows_without_ratios_make_no_picture(tmp_path: Path) -> None:
    assert not write_picture(tmp_path / "results.png", {"growth": ROWS[3:]})
    assert not (tmp_path / "results.png").exists()


def test_jobs_alternate() -> None:
    seen: list[str] = []
    alternating(lambda: seen.append("a"), repeated(lambda: seen.append("b"), 2), 3)
    assert "".join(seen) == "abbabbabb"
    assert spread([3.0, 1.0, 2.0]) == Spread(2.0, 1.0, 3.0)


@pytest.mark.slow
def test_a_failed_section_is_reported_and_others_keep_their_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(_: Scale) -> list[Row]:
        raise RuntimeError("no such luck")

    monkeypatch.setattr(benchmarks_main, "SECTIONS", (("broken", broken), ("growth", grids.growth)))
    benchmarks_main.main(["--scale", "tiny", "--folder", str(tmp_path)])
    kept = table.read_results(tmp_path / "results.json")
    assert "RuntimeError: no such luck" in kept["broken"]["rows"][0]["note"]
    assert [row["unit"] for row in kept["growth"]["rows"]] == ["x smallest", "x smallest"]
    assert "32^2 neumann: time per unknown" in capsys.readouterr().out


def test_unknown_sections_are_rejected(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        benchmarks_main.arguments(["plan"])
    assert "there is no section 'plan'" in capsys.readouterr().err


def test_a_missing_simulator_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RESGRID_NGSPICE", "no-such-program")
    monkeypatch.setattr("benchmarks.simulators.UNPACKED", Path("no-such-program"))
    assert simulator.simulator(Scale("tiny"))[0].note == "ngspice is not installed"
