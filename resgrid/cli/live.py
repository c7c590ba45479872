"""``resgrid live``: the page in which one draws while the grid is solved."""

from __future__ import annotations

import ctypes
from contextlib import suppress

import click

from resgrid.cli.options import CommandInput, verb, with_source
from resgrid.cli.scenes import open_job
from resgrid.cli.terminal import end_at_once, finish, is_computing

_ARENA_MAX = -8
"""What glibc's mallopt calls the number of heaps (M_ARENA_MAX)."""

_PATIENCE = 0.5
"""Seconds within which threads that have nothing to do end."""


@verb("live", examples=("resgrid live", "resgrid live rooms.toml", "resgrid live map.yaml --goal 5,0 --port 8080"))
@with_source(required=False)
@click.option("--host", default="127.0.0.1", help="Address to listen at; others than this computer see the page then.")
@click.option("--port", metavar="N", type=click.IntRange(0, 65535), default=8017, help="Port; 0 takes a free one.")
@click.option("--read-only", is_flag=True, help="Visitors may change k and starts only.")
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser, or only say where it is.")
def command(source: CommandInput | None, host: str, port: int, read_only: bool, browser: bool) -> int:
    """Open a page in the browser: paint walls, drag goals, and watch the current find the way; Ctrl-C ends it.

    SCENE has two axes; without one the page begins with an empty square. Needs the extra 'live', which 'make demo'
    installs.
    """
    from resgrid.live_page.launch import serve

    _share_one_heap()
    scene = None if source is None else open_job(source, require_goal=False).scene
    page = serve(scene, host=host, port=port, read_only=read_only, browser=browser)
    with page, suppress(KeyboardInterrupt):
        finish({"url": page.url}, [f"the page is at {page.url}; Ctrl-C ends it"])
        page.wait()
    if is_computing(patience=_PATIENCE):  # what nobody waits for any more
        end_at_once(0)
    return 0


def _share_one_heap() -> None:
    """Let all threads take memory from one heap: of one each, every one grows to what its largest request took."""
    with suppress(AttributeError, TypeError):  # another C library than glibc, or Windows
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)
