"""Starting and stopping the page."""

from __future__ import annotations

import logging
import socket
import sys
import threading
import time
import webbrowser
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from resgrid._internal.extras import install_command
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError, ResgridError, ToolMissingError
from resgrid.live_page.drawing import Drawing, blank, drawing_of, drawing_of_space

if TYPE_CHECKING:
    from resgrid.live_page.notebook import LiveWidget
    from resgrid.scene import Scene

_MISSING = "the live page needs starlette, uvicorn and websockets; type: {command}"
_NO_WIDGETS = "in a notebook the page is a widget, which needs anywidget; type: {command}, or pass widget=False"
_START_SECONDS = 20.0
_STOP_SECONDS = 30.0
_WORKERS = 8
"""Requests that are worked at at once: the system shares its cores among them, so that no browser waits for another."""
_WARM_CELLS = 256


class LivePage:
    """A page that is being served, until it is closed.

    Attributes
    ----------
    url : str
        What to open in a browser.
    """

    def __init__(self, drawing: Drawing, host: str, port: int, read_only: bool) -> None:
        try:
            import uvicorn

            from resgrid.live_page.messages import LARGEST
            from resgrid.live_page.server import make_app
        except ImportError as error:
            raise ToolMissingError(f"{_MISSING.format(command=install_command('live'))} ({error})") from None
        self._executor = ThreadPoolExecutor(_WORKERS, thread_name_prefix="resgrid answers")
        app = make_app(drawing, self._executor, host=host, read_only=read_only)
        self._socket = _listen(host, port)
        shown = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "::1"}.get(host, host)
        self.url = f"http://{f'[{shown}]' if ':' in shown else shown}:{self._socket.getsockname()[1]}/"
        self._server = uvicorn.Server(
            uvicorn.Config(
                app, log_level="error", access_log=False, lifespan="off", server_header=False,
                ws="websockets-sansio", ws_max_size=LARGEST, ws_per_message_deflate=False,
                timeout_graceful_shutdown=1,
            )
        )  # fmt: skip
        # An interrupted Thread.join takes a living thread for an ended one (CPython 3.11).
        self._ended = threading.Event()
        threading.Thread(target=self._serve, daemon=True).start()
        until = time.monotonic() + _START_SECONDS
        while not self._server.started and not self._ended.wait(0.01) and time.monotonic() < until:
            pass
        self._executor.submit(_load_engine, drawing)

    def __repr__(self) -> str:
        return f"<LivePage at {self.url}>"

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def _serve(self) -> None:
        try:
            self._server.run([self._socket])
        finally:
            self._ended.set()

    def wait(self) -> None:
        """Serve until interrupted."""
        while not self._ended.wait(0.5):
            pass

    def close(self) -> None:
        """Stop serving; requests that are being answered are dropped."""
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # which would be told as faults
        self._server.should_exit = True
        self._ended.wait(_STOP_SECONDS)
        self._socket.close()
        self._executor.shutdown(wait=False, cancel_futures=True)


def live(
    where: Scene | ConfigurationSpace | None = None,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    read_only: bool = False,
    browser: bool = True,
    widget: bool | None = None,
) -> LivePage | LiveWidget:
    """Open a page in the browser in which walls are painted and goals dragged while the grid settles.

    The page is served from this process, by a thread of its own, and solved by this library alone.

    Parameters
    ----------
    where : Scene or ConfigurationSpace, optional
        What to begin with, of two axes; an empty square unless it is given.
    host : str
        Address to listen at: by default nobody but this computer can reach the page.
    port : int
        Where to listen; 0 takes a free one.
    read_only : bool
        Whether visitors may change k and starts only.
    browser : bool
        Whether to open the page in a browser.
    widget : bool, optional
        Whether to return a widget for a notebook, which is solved in its kernel, without server and port; by default
        in the kernel of a notebook.

    Returns
    -------
    LivePage or LiveWidget
        With its ``url``, until ``close()`` stops it; or the widget, which shows itself.

    Raises
    ------
    InputError
        If this has not two axes, is too large to draw, or the port is taken.
    ToolMissingError
        If the extra ``resgrid[live]``, or in a notebook ``resgrid[notebook]``, is not installed.

    Examples
    --------
    >>> page = rg.live(rg.read_scene("examples/scenes/lesson.toml"), browser=False)
    >>> page.url.startswith("http://127.0.0.1:")
    True
    >>> page.close()
    """
    if _in_notebook() if widget is None else widget:
        try:
            from resgrid.live_page.notebook import LiveWidget
        except ImportError as error:
            command = install_command("notebook")
            raise ToolMissingError(f"{_NO_WIDGETS.format(command=command)} ({error})") from None
        return LiveWidget(_drawing(where), read_only=read_only)
    return serve(where, host=host, port=port, read_only=read_only, browser=browser)


def serve(
    where: Scene | ConfigurationSpace | None, *, host: str, port: int, read_only: bool, browser: bool
) -> LivePage:
    """Serve the page at an address."""
    page = LivePage(_drawing(where), host, port, read_only)
    if browser:
        webbrowser.open(page.url)
    return page


def _drawing(where: Scene | ConfigurationSpace | None) -> Drawing:
    if isinstance(where, ConfigurationSpace):
        return drawing_of_space(where)
    return blank() if where is None else drawing_of(where)


def _in_notebook() -> bool:
    """Whether the kernel of a notebook runs this."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


def _load_engine(first: Drawing) -> None:
    """Load the engine and its loops while the browser is still opening: solve the first drawing, or a smaller one."""
    from resgrid.live_page.solving import solve_drawing

    cells = max(first.cell.shape)
    with suppress(ResgridError):
        solve_drawing(first if cells <= _WARM_CELLS else replace(blank(_WARM_CELLS), k=first.k), exact=True)


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        raise InputError(f"cannot listen at {host}:{port} ({error}); choose another with --port") from None
