"""Starting and stopping the page."""

from __future__ import annotations

import socket
import threading
import time
import webbrowser
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from resgrid.errors import InputError, ToolMissingError
from resgrid.page.drawing import Drawing, blank, drawing_of, drawing_of_space
from resgrid.scene import Scene
from resgrid.space import ConfigurationSpace

PORT = 8017
_MISSING = "the live page needs starlette, uvicorn and websockets; type: pip install 'resgrid[live]'"
_START_SECONDS = 20.0


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

            from resgrid.page.messages import LARGEST
            from resgrid.page.server import hosts_of, make_app
        except ImportError as error:
            raise ToolMissingError(f"{_MISSING} ({error})") from None
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="resgrid solves")
        app = make_app(drawing, self._executor, hosts=hosts_of(host), read_only=read_only)
        self._socket = _listen(host, port)
        shown = "127.0.0.1" if host in ("0.0.0.0", "") else host
        self.url = f"http://{f'[{shown}]' if ':' in shown else shown}:{self._socket.getsockname()[1]}/"
        self._server = uvicorn.Server(
            uvicorn.Config(
                app, log_level="critical", access_log=False, lifespan="off", server_header=False,
                ws="websockets-sansio", ws_max_size=LARGEST, ws_per_message_deflate=False,
                timeout_graceful_shutdown=1,
            )
        )  # fmt: skip
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), daemon=True)
        self._thread.start()
        until = time.monotonic() + _START_SECONDS
        while not self._server.started and self._thread.is_alive() and time.monotonic() < until:
            time.sleep(0.01)

    def __repr__(self) -> str:
        return f"<LivePage at {self.url}>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" style="width: 100%; height: 640px; border: 0"></iframe>'

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def wait(self) -> None:
        """Serve until interrupted."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def close(self) -> None:
        """Stop serving."""
        self._server.should_exit = True
        self._thread.join(5.0)
        self._socket.close()
        self._executor.shutdown(wait=False, cancel_futures=True)


def live(
    where: Scene | ConfigurationSpace | None = None,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    read_only: bool = False,
    browser: bool = True,
) -> LivePage:
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

    Returns
    -------
    LivePage
        With its ``url``; ``close()`` stops it.  In a notebook it shows itself.

    Raises
    ------
    InputError
        If this has not two axes, is too large to draw, or the port is taken.
    ToolMissingError
        If the extra ``resgrid[live]`` is not installed.

    Examples
    --------
    >>> page = rg.live(rg.read_scene("examples/scenes/lesson.toml"), browser=False)
    >>> page.url.startswith("http://127.0.0.1:")
    True
    >>> page.close()
    """
    if isinstance(where, ConfigurationSpace):
        drawing = drawing_of_space(where)
    else:
        drawing = blank() if where is None else drawing_of(where)
    page = LivePage(drawing, host, port, read_only)
    if browser:
        webbrowser.open(page.url)
    return page


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        raise InputError(f"cannot listen at {host}:{port} ({error}); choose another with --port") from None
