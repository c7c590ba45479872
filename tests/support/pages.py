"""Access to the live page by its socket and by a browser."""

from __future__ import annotations

import json
import os
import shutil
import time
from typing import Any

import numpy as np
from playwright.sync_api import Page
from websockets.sync.client import ClientConnection, connect

from resgrid.live_page import LivePage
from resgrid.live_page.drawing import Drawing
from resgrid.live_page.messages import write_drawing

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
OPTIONS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
]  # fmt: skip
PATIENCE = 300.0
"""Time limit for an answer in seconds, including the compilation of kernels."""

Answer = tuple[dict[str, Any], bytes]


def browser_program() -> str:
    """Return the browser of the system."""
    names = [os.environ["RESGRID_CHROMIUM"]] if "RESGRID_CHROMIUM" in os.environ else BROWSERS
    found = next(filter(None, map(shutil.which, names)), None)
    assert found, "there is no Chromium; type: scripts/install_chromium.sh"
    return found


def dial(page: LivePage, **options: Any) -> ClientConnection:
    """Open a connection with the headers of the page, or with other headers."""
    url = page.url.rstrip("/")
    options = {"origin": url, "max_size": None, "open_timeout": PATIENCE, "proxy": None} | options
    return connect(url.replace("http", "ws", 1) + "/ws", **options)


def read(message: str | bytes) -> Answer:
    """Return head and body of a message."""
    assert isinstance(message, bytes)
    size = int.from_bytes(message[:4], "little")
    return json.loads(message[4 : 4 + size]), message[4 + size :]


def written(head: dict[str, Any], body: bytes = b"") -> bytes:
    """Return a message in the format of the page."""
    text = json.dumps(head).encode()
    return len(text).to_bytes(4, "little") + text + body


def ask(socket: ClientConnection, head: dict[str, Any], body: bytes = b"") -> Answer:
    """Return the answer to a request."""
    socket.send(written({"seq": 1, **head}, body))
    return read(socket.recv(timeout=PATIENCE))


def about(kind: str, drawing: Drawing, **more: Any) -> tuple[dict[str, Any], bytes]:
    """Return a request for a drawing."""
    head, body = write_drawing(drawing)
    return {"type": kind, "drawing": head["drawing"], **more}, body


def until(page: Page, condition: str) -> None:
    """Wait until a condition is true on a page."""
    end = time.monotonic() + PATIENCE
    while not page.evaluate(f"Boolean({condition})"):
        assert time.monotonic() < end, f"{condition} did not come true: {page.inner_text('#quality')}"
        time.sleep(0.02)


def settle(page: Page) -> None:
    """Wait until the drawing has been solved and certified."""
    until(page, "live.model.scene && [live.solved, live.settled].every((one) => one === live.model.scene)")
    until(page, "live.frames.at(-1).exact")


def open_example(page: Page, name: str) -> None:
    """Open an example by its button in the menu, and wait until it is shown."""
    past = page.evaluate("live.model.past.length")
    page.locator("#examples").click()
    page.locator(f"#choosing [data-example={name}]").click()
    until(page, f"live.model.past.length > {past}")


def example_names(page: Page) -> list[str]:
    """Return the names of the examples in the menu."""
    return [example["name"] for example in page.evaluate("live.panel.examples")]


def lines(page: Page) -> list[np.ndarray]:
    """Return the paths on a page in cells, each (n, 2)."""
    shown = page.evaluate("live.view.frame.lines.map((line) => Array.from(line))")
    return [np.reshape(line, (-1, 2)) for line in shown]


def kept(page: Page) -> str:
    """Return the scene on a page as text."""
    text = page.evaluate("import('/static/model.js').then((model) => model.keepScene(live.model.scene))")
    assert isinstance(text, str)
    return text


def link_of(page: Page) -> str:
    """Return the link to the scene on a page."""
    link = page.evaluate("import('/static/files.js').then((files) => files.linkOf(live.wire, live.model.scene))")
    assert isinstance(link, str)
    return link


def point_on(page: Page, cell: tuple[float, float]) -> tuple[float, float]:
    """Return the screen position of a point in cells."""
    script = """([i, j]) => {
        const around = live.view.canvas.getBoundingClientRect(), ratio = live.view.canvas.width / around.width;
        const [x, y] = live.view.toPixels([i, j]);
        return [around.left + x / ratio, around.top + y / ratio];
    }"""
    x, y = page.evaluate(script, list(cell))
    return x, y


def drag(page: Page, cells: list[tuple[int, int]]) -> None:
    """Drag the mouse from the first cell over the others."""
    places = [point_on(page, (i + 0.5, j + 0.5)) for i, j in cells]
    page.mouse.move(*places[0])
    page.mouse.down()
    for place in places[1:]:
        page.mouse.move(*place, steps=4)
    page.mouse.up()
