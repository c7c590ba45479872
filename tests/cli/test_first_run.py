from pathlib import Path

import pytest

from resgrid.cli.scenes import is_first_run


def test_a_kept_loop_ends_the_first_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert is_first_run()
    (tmp_path / "nodal_1").mkdir()
    (tmp_path / "nodal_1" / "row_kernels.conductances_by_row-9.py311.nbi").touch()
    assert not is_first_run()
