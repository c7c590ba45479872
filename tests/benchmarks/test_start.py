"""Times of the first command and the first solution."""

import pytest

from benchmarks import start
from benchmarks.rows import Scale


@pytest.mark.slow
def test_a_first_solution_reports_time_and_method() -> None:
    seconds, method = start._python(start.FIRST.format(kind="maze", size=24, seed=3, accuracy="direction")).split()
    assert float(seconds) > 0.0
    assert method in {"direct", "elimination", "multigrid"}


def test_every_first_solution_has_its_own_empty_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    caches = []

    def python(_: str, **environment: str) -> str:
        caches.extend(environment.values())
        return "1.5 direct" if environment else ""

    monkeypatch.setattr(start, "_python", python)
    rows = start.start(Scale("tiny", rounds=2))
    assert [row.value.median for row in rows if row.note] == [1.5, 1.5, 1.5]
    assert len(set(caches)) == 3
    assert {row.unit for row in rows} == {"s"}
