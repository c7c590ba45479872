"""Checkpoint files that grow line by line: truncation at any byte, foreign files, and write errors.

Tests internals: `resgrid._internal.checkpoints`.
"""

from __future__ import annotations

import os
import resource
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

import resgrid as rg
from resgrid._internal.checkpoints import Journal

HEAD = {"resgrid": "test", "fingerprint": "abc"}
RECORDS = st.lists(st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=9), max_size=3), max_size=6)


def write_journal(path: Path, records: list[dict[str, object]]) -> None:
    journal = Journal(path, HEAD)
    for record in records[len(list(journal)) :]:
        journal.append(record)


@pytest.mark.slow
@given(RECORDS, st.data())
def test_a_file_truncated_at_any_byte_is_completed_to_the_same_bytes(
    records: list[dict[str, object]], data: st.DataObject
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.jsonl"
        write_journal(path, records)
        whole = path.read_bytes()
        path.write_bytes(whole[: data.draw(st.integers(0, len(whole)))])
        found = list(Journal(path, HEAD))
        assert found == records[: len(found)]
        write_journal(path, records)
        assert path.read_bytes() == whole
        assert list(Journal(path, HEAD)) == records


def test_an_incomplete_long_line_is_removed(tmp_path: Path) -> None:
    write_journal(tmp_path / "file", [{"a": 1}, {"b": "x" * 200_000}])
    data = (tmp_path / "file").read_bytes()
    (tmp_path / "file").write_bytes(data[:-5])
    assert list(Journal(tmp_path / "file", HEAD)) == [{"a": 1}]
    assert (tmp_path / "file").read_bytes() == data[: data.rindex(b'{"b"')]


def test_files_of_other_runs_raise_input_error_and_stay_unchanged(tmp_path: Path) -> None:
    file = tmp_path / "file"
    for data, message in (
        (b'{"resgrid":"test","fingerprint":"xyz"}\n{}\ntorn', "belongs to another run"),
        (b"x,y\n1,2\n", "cannot read the checkpoint"),
        (b"\x00\xff" * 100, "cannot read the checkpoint"),
        (b'{"resgrid":"tes\n', "cannot read the checkpoint"),
        (b'{"resgrid":"other', "cannot read the checkpoint"),
        (b'{"resgrid":"test"}\n', "its first line is not that of a checkpoint"),
    ):
        file.write_bytes(data)
        with pytest.raises(rg.InputError, match=message):
            Journal(file, HEAD)
        assert file.read_bytes() == data


def test_a_write_error_raises_input_error_and_the_file_is_completed_later(tmp_path: Path) -> None:
    file, limits = tmp_path / "file", resource.getrlimit(resource.RLIMIT_FSIZE)
    journal = Journal(file, HEAD)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file.stat().st_size + 3, limits[1]))  # the disk is full
    try:
        with pytest.raises(rg.InputError, match=r"cannot write the checkpoint .*file.*: File too large; check"):
            journal.append({"a": 1})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    write_journal(file, [{"a": 1}])
    assert list(Journal(file, HEAD)) == [{"a": 1}]


def test_a_file_without_write_permission_raises_input_error() -> None:
    """The test switches to another user, because permissions do not apply to root."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "chips.jsonl"
        file.touch(0o444)
        Path(folder).chmod(0o555)
        user = os.geteuid()
        os.seteuid(user or 65534)
        try:
            for path in (file, Path(folder) / "new", Path(folder) / "missing" / "new", Path(folder)):
                with pytest.raises(rg.InputError, match="cannot write the checkpoint"):
                    Journal(path, HEAD)
        finally:
            os.seteuid(user)
