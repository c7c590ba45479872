"""Random actions in Chromium: no error in page or server, and no memory growth; `make fuzz` runs ten thousand."""

from __future__ import annotations

import logging
import os
import random
import subprocess
from collections.abc import Iterator

import psutil
import pytest
from playwright.sync_api import Browser, CDPSession, Page
from support.cli import COMMAND
from support.fuzzing import act, rest
from support.pages import kept, open_example, settle

ACTIONS = int(os.environ.get("RESGRID_PAGE_ACTIONS", "150"))
SEED = int(os.environ.get("RESGRID_PAGE_SEED", "1"))
PARTS = 5
MOST_BYTES = 3e6, 8e6, 80e6
"""Largest growth in bytes of the page's objects, its buffers and the server, relative to the first (warm-up) part."""
_log = logging.getLogger(__name__)


@pytest.fixture
def server(tmp_path) -> Iterator[tuple[psutil.Process, str]]:
    """A server process and its URL; text on its standard error fails the test."""
    with (tmp_path / "errors").open("w+") as errors:
        command = [*COMMAND, "live", "--no-browser", "--port", "0"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process:
            assert process.stdout is not None
            url = process.stdout.readline().split()[4].rstrip(";")
            yield psutil.Process(process.pid), url
            process.terminate()
        errors.seek(0)
        assert not errors.read()


def measured(page: Page, developer: CDPSession, process: psutil.Process, first: str) -> tuple[float, float, float]:
    """Bytes of the page's objects, its buffers and the server, at the first scene with an empty history."""
    rest(page, first)
    settle(page)
    for _ in range(2):
        developer.send("HeapProfiler.collectGarbage")
        page.wait_for_timeout(100)
    heap = developer.send("Runtime.getHeapUsage")
    return heap["usedSize"], heap["backingStorageSize"], process.memory_info().rss


def load_packages(page: Page) -> None:
    """Let the server import its packages before the first measurement: open two examples, and save in every format."""
    for name in ("scara", "rooms"):
        open_example(page, name)
        settle(page)
    for kind in ("toml", "csv", "svg", "deck"):
        page.evaluate("(format) => live.wire.ask({ type: 'save', format }, live.model.scene).then(() => 0)", kind)


@pytest.mark.slow
def test_random_actions_cause_no_errors_and_no_memory_growth(server: tuple[psutil.Process, str], chromium: Browser):
    process, url = server
    context = chromium.new_context(viewport={"width": 1280, "height": 720}, has_touch=True)
    page = context.new_page()
    wrong: list[str] = []
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(error.stack or str(error)))
    page.on("filechooser", lambda _: None)
    page.goto(f"{url}?tour=0")
    settle(page)
    first, developer, rng = kept(page), context.new_cdp_session(page), random.Random(SEED)
    load_packages(page)
    figures = []
    for _ in range(PARTS):
        act(page, rng, ACTIONS // PARTS)
        figures.append(measured(page, developer, process, first))
        _log.info(
            "%.1f MB of objects, %.1f MB of buffers, %.1f MB at the server", *(part / 1e6 for part in figures[-1])
        )
        assert not wrong
        assert kept(page) == first
    for warm, last, most in zip(figures[0], figures[-1], MOST_BYTES, strict=True):
        assert last - warm < most, figures
    context.close()
