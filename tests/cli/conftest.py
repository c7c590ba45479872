from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from support import cli


@pytest.fixture
def call() -> Callable[..., Result]:
    return cli.call


@pytest.fixture
def answer() -> Callable[..., dict[str, Any]]:
    return cli.answer


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ``resgrid run`` write no pictures, most of its time on small grids."""
    monkeypatch.setattr("resgrid.cli.run.draw_all", lambda *_drawn: {})


@pytest.fixture
def lesson(scenes: Path) -> Path:
    return scenes / "lesson.toml"


@pytest.fixture
def room(tmp_path: Path) -> Path:
    file = tmp_path / "room.toml"
    file.write_text(cli.ROOM)
    return file
