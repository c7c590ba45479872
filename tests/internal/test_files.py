"""Atomic files and folders: bytes, permissions, failures, killed processes and concurrent runs.

Tests internals: `resgrid._internal.files`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import resgrid as rg
from resgrid._internal.files import atomic_path, read_bytes, whole_folder, write_bytes, write_text


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_text_is_written_byte_for_byte(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "é\n\r\n")
    assert (tmp_path / "a.txt").read_bytes() == b"\xc3\xa9\n\r\n"
    assert names(tmp_path) == ["a.txt"]


def test_permissions_follow_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        path = write_bytes(tmp_path / "a", b"")
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("size", [10, 11])
def test_a_pipe_has_the_limit_of_a_file(tmp_path: Path, size: int) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with subprocess.Popen([sys.executable, "-c", f"open({str(pipe)!r}, 'wb').write(b'x' * {size})"]):
        if size > 10:
            with pytest.raises(rg.InputError, match="more than 10 bytes"):
                read_bytes(pipe, 10)
        else:
            assert read_bytes(pipe, 10) == b"x" * 10


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
def test_a_failure_keeps_the_old_file_and_removes_the_temporary_one(
    tmp_path: Path, failure: type[BaseException]
) -> None:
    path = write_text(tmp_path / "deck.cir", "old")
    with pytest.raises(failure), atomic_path(path) as temporary:
        assert temporary.suffix == ".cir"
        temporary.write_text("half")
        raise failure
    assert path.read_text() == "old"
    assert names(tmp_path) == ["deck.cir"]


def test_temporary_files_of_a_killed_process_are_removed_by_the_next_run(tmp_path: Path) -> None:
    left = [tmp_path / name for name in (".deck-0123456789ab.cir", ".deck-0123456789ac.cir", ".deck-of-mine.cir")]
    for file in left:
        file.touch()
    for file in left[::2]:
        os.utime(file, (0, 0))
    (tmp_path / ".out-0123456789ab").mkdir()
    os.utime(tmp_path / ".out-0123456789ab", (0, 0))
    write_text(tmp_path / "deck.cir", "new")
    assert names(tmp_path) == [".deck-0123456789ac.cir", ".deck-of-mine.cir", ".out-0123456789ab", "deck.cir"]
    with whole_folder(tmp_path / "out"):
        pass
    assert names(tmp_path) == [".deck-0123456789ac.cir", ".deck-of-mine.cir", "deck.cir", "out"]


def test_a_folder_that_another_run_is_writing_raises_input_error(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "out") as first:
        (first / "a").touch()
        os.utime(first, (0, 0))  # the age of the folder does not matter
        with pytest.raises(rg.InputError, match="another run is writing this folder"), whole_folder(tmp_path / "out"):
            pass
        with whole_folder(tmp_path / "other"):
            pass
    assert names(tmp_path) == ["other", "out"] and names(tmp_path / "out") == ["a"]
    with whole_folder(tmp_path / "out"):
        pass


def test_a_folder_of_a_killed_run_is_written_by_the_next_run(tmp_path: Path) -> None:
    program = "import os\nfrom resgrid._internal.files import whole_folder\nwith whole_folder('out'):\n    os._exit(9)"
    assert subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=False).returncode == 9
    assert len(names(tmp_path)) == 1
    with whole_folder(tmp_path / "out"):
        pass
    assert "out" in names(tmp_path)


def test_links_are_followed_and_devices_and_pipes_are_written(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_text(tmp_path / "link", "x")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "x"
    write_text("/dev/null", "x")
    assert Path("/dev/null").is_char_device()
    reader, writer = os.pipe()
    write_text(f"/dev/fd/{writer}", "x")
    assert os.read(reader, 9) == b"x"
    os.close(reader)
    os.close(writer)


@pytest.mark.parametrize("name", ["", "missing/a.txt", "a\0b", "x" * 300, "file/a.txt"])
def test_invalid_file_names_raise_input_error(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(rg.InputError, match="cannot write"):
        write_text(f"{tmp_path}/{name}", "x")
    assert names(tmp_path) == ["file"]


def test_a_temporary_folder_is_removed_at_process_exit_during_its_removal(tmp_path: Path) -> None:
    program = """
import os, shutil, threading, time, weakref
from resgrid._internal.files import temporary_folder

removing, remove = threading.Event(), shutil.rmtree

def slowly(*arguments, **options):
    if threading.current_thread() is not threading.main_thread():
        removing.set()
        time.sleep(600)
    remove(*arguments, **options)

def work():
    with temporary_folder() as folder:
        (folder / "file").write_text("content")

shutil.rmtree = slowly
threading.Thread(target=work, daemon=True).start()
removing.wait()
weakref.finalize._exitfunc()
os._exit(0)
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300, env=os.environ | {"TMPDIR": str(tmp_path)})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("obstacle", ["b/", "c"])
def test_no_result_is_moved_if_one_of_them_has_no_place(tmp_path: Path, obstacle: str) -> None:
    """A directory has the name of the file b, or a file the name of the folder c."""
    target = tmp_path / "out"
    target.mkdir()
    (target / obstacle).mkdir() if obstacle.endswith("/") else (target / obstacle).touch()
    with pytest.raises(rg.InputError, match=r"name another folder$"), whole_folder(target) as folder:
        (folder / "c").mkdir()
        for name in ("a", "b", "c/d"):
            (folder / name).touch()
    assert names(target) == [obstacle.rstrip("/")] and names(tmp_path) == ["out"]
