"""Results on disk: keys, damaged files, and folders that cannot be written.

Tests internals: `resgrid._internal.cache`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from resgrid._internal.cache import cache_folder, fingerprint, load_array, store_array


@dataclass
class Pair:
    first: float
    second: np.ndarray


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


def test_the_folder_follows_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RESGRID_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "resgrid"


def test_fingerprints_differ_when_any_part_differs() -> None:
    values = [
        Pair(1.0, np.zeros(2)),
        Pair(1.0, np.zeros((2, 1))),
        Pair(1.0, np.zeros(2, dtype=np.float32)),
        Pair(np.nextafter(1.0, 2), np.zeros(2)),
        (1.0, np.zeros(2)),
        {"a": 1},
        {"a": 1.0},
        {"b": 1},
        ("ab", "c"),
        ("a", "bc"),
        (("a",), "bc"),
        None,
        False,
        0,
    ]
    keys = [fingerprint(value) for value in values]
    assert len(set(keys)) == len(values)
    assert keys == [fingerprint(value) for value in values]
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
