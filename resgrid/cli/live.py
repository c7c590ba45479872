"""``resgrid live``: serve the live page, a browser editor of scenes with a continuously solved grid, or a 3-D view.

Scenes with two axes have the editor; arms, points and balls in space have the 3-D view.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress
from typing import TYPE_CHECKING

import click

import resgrid as rg
from resgrid.cli.options import CommandInput, subcommand, with_source
from resgrid.cli.scenes import Job, open_job
from resgrid.cli.terminal import end_at_once, finish, is_computing
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.live_page.launch import LivePage
    from resgrid.viewer.launch import Viewer

_ARENA_MAX = -8
"""Number by which glibc's function mallopt selects the parameter M_ARENA_MAX, the largest number of heaps (arenas)."""

_LOCAL = "127.0.0.1"
"""Address of a server to which only this computer has access."""

_SHUTDOWN_SECONDS = 0.5
"""Longest wait for the end of running computations, in seconds, before the process ends without them."""


@subcommand(
    "live", examples=("resgrid live", "resgrid live rooms.toml", "resgrid live map.yaml --goal 5,0 --port 8080")
)
@with_source(required=False)
@click.option("--host", default=_LOCAL, help="Address of the server; with 0.0.0.0 other computers have access.")
@click.option("--port", metavar="N", type=click.IntRange(0, 65535), default=8017, help="Port; 0 for any free port.")
@click.option("--read-only", is_flag=True, help="Visitors can only change k and starts.")
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser, or only print its address.")
def command(source: CommandInput | None, host: str, port: int, read_only: bool, browser: bool) -> int:
    """Open a page in the browser to draw walls and move goals while field and paths are computed; Ctrl-C ends it.

    SCENE must have two axes; without SCENE, the page shows an empty square. Needs the extra 'live', which 'make demo'
    installs. An arm, a point or a ball in space is shown in a 3-D view, with handles for start and goal; it needs the
    extra 'viewer'.
    """
    from resgrid.robots.voxel_surfaces import is_voxel_world

    _share_one_heap()
    job = None if source is None else open_job(source, require_goal=False)
    page: LivePage | Viewer
    if job is not None and (job.scene.robot.workspace_ndim == 3 or is_voxel_world(job.space)):
        page = _open_view(job, host, port, read_only, browser)
    else:
        from resgrid.live_page.launch import serve

        scene = None if job is None else job.scene
        page = serve(scene, host=host, port=port, read_only=read_only, browser=browser)
    with page, suppress(KeyboardInterrupt):
        finish({"url": page.url}, [f"the page is at {page.url}; Ctrl-C ends it"])
        page.wait()
    if is_computing(patience=_SHUTDOWN_SECONDS):  # a solution that is no longer needed
        end_at_once(0)
    return 0


def _open_view(job: Job, host: str, port: int, read_only: bool, browser: bool) -> Viewer:
    """Open a page with a 3-D view of the scene, whose robot moves in space, and return the view.

    `host`: address of the server; `port`: its port, 0 for any free one; `browser`: whether to open the page in the
    browser.  Raises InputError for `read_only` and for another host than this computer, which only plane pages support.
    """
    if host != _LOCAL:
        raise InputError(f"--host {host}: the 3-D view serves this computer only; leave out --host")
    if read_only:
        raise InputError("--read-only: the 3-D view has no such mode; leave out the option")
    return rg.view(job.scene, space=job.space, port=port, browser=browser)


def _share_one_heap() -> None:
    """Make all threads allocate from one heap of glibc, because each heap keeps the peak memory of its thread."""
    with suppress(AttributeError, TypeError):  # the C library is not glibc, or the system is Windows
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)
