"""Contenders in separate processes: measurements, failures, time limits."""

from __future__ import annotations

import io
import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from benchmarks import peers
from benchmarks.comparison import RTOL, alternate, best_peer, compare, ratio_rows, work_rows
from benchmarks.contest import Contender, Run, arena, prepare, run_once
from benchmarks.problems import Problem
from benchmarks.rows import RATIO, Scale
from benchmarks.worker import serve

TINY = Scale("tiny", rounds=2, limit=60.0)
PROBLEM = Problem("rectangles", 16)


@pytest.mark.slow
def test_resgrid_and_a_peer_solve_the_same_equations() -> None:
    rows = compare(PROBLEM, TINY, peers=["superlu"])
    compared = {row.contender: row for row in rows if row.unit == RATIO}
    assert set(compared) == {"resgrid", "SuperLU (scipy)"}
    assert "residual" not in "".join(row.note for row in rows)
    assert compared["resgrid"].value is not None
    assert compared["resgrid"].value.median == 1.0
    best = best_peer(rows)
    assert best is not None
    assert best.contender == "SuperLU (scipy)"
    assert {row.unit for row in rows} >= {RATIO, "products", "x solve phase"}


def test_a_peer_beyond_the_time_limit_is_terminated() -> None:
    with arena(PROBLEM, ["superlu"]) as ring:
        run = run_once(ring, "superlu", rtol=RTOL, limit=1e-6)
        assert "not done after" in run.failure
        assert "ended" in run_once(ring, "superlu", rtol=RTOL, limit=60.0).failure


def test_a_missing_library_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def absent(_: peers.Matrix) -> peers.Setup:
        raise ImportError("no module of that name")

    monkeypatch.setitem(peers.PEERS, "absent", peers.Peer("absent", absent, True, "absent"))
    write_equations(tmp_path)
    assert "ImportError: no module of that name" in answers("absent", tmp_path, 1)[0]["failure"]


def test_a_worker_answers_every_request(tmp_path: Path) -> None:
    write_equations(tmp_path)
    first, second = answers("superlu", tmp_path, 2)
    assert first["seconds"].keys() == second["seconds"].keys() == {"setup", "solve"}
    np.testing.assert_allclose(np.load(tmp_path / "superlu.npy"), [1.0, 2.0])


def test_an_unknown_contender_reports_a_failure() -> None:
    contender = Contender("nobody")
    try:
        assert "failure" in contender.ask({"folder": "nowhere", "rtol": 1e-8}, 60.0)
    finally:
        contender.close()


def test_a_failed_preparation_leaves_one_failed_run() -> None:
    with arena(PROBLEM, ["superlu"]) as ring:
        (ring.folder / "rhs.npy").unlink()
        assert "FileNotFoundError" in prepare(ring, "superlu", 60.0)
        runs = alternate(ring, TINY)
    assert [run.failure[:17] for run in runs["superlu"]] == ["FileNotFoundError"]


def test_ratios_are_computed_per_round() -> None:
    own = [Run({"substitute": 1.0}, residual=0.0), Run({"substitute": 2.0}, residual=0.0)]
    peer = [Run({"setup": 1.0, "solve": 2.0}, residual=0.0), Run({"setup": 1.0, "solve": 1.0}, residual=0.0)]
    missed = [Run({"setup": 0.1, "solve": 0.1}, residual=1e-3)] * 2
    rows = {r.contender: r for r in ratio_rows("p", {"resgrid": own, "superlu": peer, "gamg": missed})}
    value = rows["SuperLU (scipy)"].value
    assert value is not None
    assert (value.median, value.low, value.high) == (2.0, 1.0, 3.0)
    assert "residual 1.0e-03 only" in rows["PETSc GAMG + CG"].note
    best = best_peer(list(rows.values()))
    assert best is not None
    assert best.contender == "SuperLU (scipy)"


def test_work_is_counted_in_products_of_the_solve_phase() -> None:
    run = Run({"assemble": 1.0, "factor": 2.0, "substitute": 4.0}, iterations=9, residual=0.0)
    rows = {row.unit: row.value for row in work_rows("p", [run], 0.1) if row.value}
    assert math.isclose(rows["products"].median, 40.0)
    assert rows["iterations"].median == 9
    assert rows["x solve phase"].median == 0.5


def write_equations(folder: Path) -> None:
    """Write the equations 2 x = 2, 3 y = 6."""
    (folder / "problem.json").write_text(json.dumps(asdict(PROBLEM)))
    arrays = {"indptr": np.arange(3, dtype=np.int32), "indices": np.arange(2, dtype=np.int32)}
    for name, array in {**arrays, "data": np.array([2.0, 3.0]), "rhs": np.array([2.0, 6.0])}.items():
        np.save(folder / f"{name}.npy", array)


def answers(name: str, folder: Path, count: int) -> list[dict[str, object]]:
    order = json.dumps({"folder": str(folder), "rtol": 1e-8}) + "\n"
    replies = io.StringIO()
    serve(name, io.StringIO(order * count), replies)
    return [json.loads(line) for line in replies.getvalue().splitlines()]
