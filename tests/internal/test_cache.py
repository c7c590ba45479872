"""Results on disk: keys, damaged files, and folders that cannot be written.

Tests internals: `resgrid._internal.cache`.
"""

import fcntl
from pathlib import Path
from typing import IO

import numpy as np
import pytest

from resgrid._internal.cache import cache_folder, load_array, store_array, unfinished_file


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RESGRID_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_an_array_is_found_again_under_its_key_only(folder: Path) -> None:
    array = np.arange(6, dtype=np.uint8).reshape(2, 3)
    assert load_array("cells", "key") is None
    store_array("cells", "key", array)
    np.testing.assert_array_equal(load_array("cells", "key"), array)
    assert load_array("cells", "other") is None
    assert [path.name for path in folder.iterdir()] == ["cells-key.npz"]


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04 cut", b"no archive"])
def test_a_damaged_file_counts_as_missing(folder: Path, data: bytes) -> None:
    store_array("cells", "key", np.ones(3))
    (folder / "cells-key.npz").write_bytes(data)
    assert load_array("cells", "key") is None


def test_without_a_folder_nothing_is_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RESGRID_CACHE", "")
    assert cache_folder() is None
    store_array("cells", "key", np.ones(3))
    assert load_array("cells", "key") is None
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("RESGRID_CACHE", str(tmp_path / "file" / "below"))
    store_array("cells", "key", np.ones(3))
    assert load_array("cells", "key") is None


def test_a_lock_on_a_deleted_file_does_not_count(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that deletes the lock file ends between the opening and the locking by this one."""
    real, flock = folder / "cells-key.lock", fcntl.flock

    def late(file: IO[str], flags: int) -> None:
        real.unlink()
        flock(file, flags)

    monkeypatch.setattr(fcntl, "flock", late)
    with unfinished_file("cells", "key") as path:
        assert path is None


def test_the_folder_follows_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RESGRID_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "resgrid"


def test_an_unfinished_file_stays_after_an_interruption_and_is_deleted_after_success(folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt), unfinished_file("cells", "key") as path:
        assert path is not None
        path.write_text("one block")
        raise KeyboardInterrupt
    with unfinished_file("cells", "key") as path, unfinished_file("cells", "key") as second:
        assert path is not None
        assert path.read_text() == "one block"
        assert second is None
    assert list(folder.iterdir()) == []


def test_without_a_folder_there_is_no_unfinished_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RESGRID_CACHE", "")
    with unfinished_file("cells", "key") as path:
        assert path is None
