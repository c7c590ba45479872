"""Start and stop of the live page, by its own server or as a widget in a notebook."""

from __future__ import annotations

import errno
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
"""Longest wait for the start of the server, in seconds; after that, the page is returned before the server answers."""

_STOP_SECONDS = 30.0
"""Longest wait for the end of the server, in seconds; after that, its socket is closed while requests may still run."""

_WORKERS = 8
"""Number of requests that are answered in parallel; further requests wait."""

_WARM_CELLS = 256
"""Largest number of cells per axis of an initial drawing that is solved at the start, to load the compiled kernels.

Instead of a larger drawing, a blank one with this number of cells per axis is solved.
"""


class LivePage:
    """A live page and its server; `close`, or the end of a ``with`` block, stops the server.

    Parameters
    ----------
    drawing : Drawing
        Initial drawing.
    host : str
        Address of the server.
    port : int
        Port of the server; 0 for any free port.
    read_only : bool
        Whether visitors can only change the Dirichlet weight k and the starts.

    Attributes
    ----------
    url : str
        Address of the page, to open in a browser.
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
        # Thread.join is not used: after an interrupt it reports a running thread as ended (CPython 3.11).
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
        """Block until the server ends, or until the user interrupts the process."""
        while not self._ended.wait(0.5):
            pass

    def close(self) -> None:
        """Stop the server and discard unanswered requests."""
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # dropped requests would be logged as errors
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
    """Open the live page, a browser editor of obstacles, goals and starts whose grid is solved after every change.

    A thread of this process serves the page and solves its grid.

    Parameters
    ----------
    where : Scene or ConfigurationSpace, optional
        Initial drawing, with two axes; an empty square by default.
    host : str
        Address of the server; by default only this computer has access.
    port : int
        Port of the server; 0 for any free port.
    read_only : bool
        Whether visitors can only change the Dirichlet weight k and the starts.
    browser : bool
        Whether to open the page in a browser; without effect for a widget, like `host` and `port`.
    widget : bool, optional
        Whether to return a notebook widget, which runs in the notebook's kernel without a server; by default true in
        the kernel of a notebook, otherwise false.

    Returns
    -------
    LivePage or LiveWidget
        The served page, with its ``url`` and ``close()``; or the widget.

    Raises
    ------
    InputError
        If `where` does not have two axes or is too large to draw, or if the port is in use.
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
    """Start a server of the live page, and return the page.

    `where`: initial drawing, None for an empty square; `host`, `port`: address of the server, port 0 for any free port;
    `read_only`: whether visitors can only change the Dirichlet weight k and the starts; `browser`: whether to open the
    page in a browser.
    """
    page = LivePage(_drawing(where), host, port, read_only)
    if browser:
        webbrowser.open(page.url)
    return page


def _drawing(where: Scene | ConfigurationSpace | None) -> Drawing:
    if isinstance(where, ConfigurationSpace):
        return drawing_of_space(where)
    return blank() if where is None else drawing_of(where)


def _in_notebook() -> bool:
    """Return whether the running process is the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


def _load_engine(first: Drawing) -> None:
    """Import the solvers and load their compiled kernels, by solving a drawing.

    `first`: initial drawing, which is solved if it has at most 256 cells per axis; else a blank drawing is solved.
    """
    from resgrid.live_page.solving import solve_drawing

    cells = max(first.cell.shape)
    with suppress(ResgridError):
        solve_drawing(first if cells <= _WARM_CELLS else replace(blank(_WARM_CELLS), k=first.k), exact=True)


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        remedy = "choose another port, or 0 for any free port (--port 0)"
        if isinstance(error, OSError) and error.errno not in (errno.EADDRINUSE, errno.EACCES):
            remedy = "give an address of this computer, such as --host 127.0.0.1"
        raise InputError(f"cannot listen at {host}:{port} ({error}); {remedy}") from None
