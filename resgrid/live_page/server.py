"""The server of the page: static files, and one WebSocket per browser.

This module does not import solvers, so that the page is served while their import is still running.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from resgrid.live_page.drawing import Drawing

if TYPE_CHECKING:
    from resgrid.live_page.session import Session

STATIC = Path(__file__).parent / "static"
MAX_BROWSERS = 32
"""Largest number of browsers that are connected at the same time; further connections are refused."""

_HEADERS = {
    "content-security-policy": "default-src 'self'; img-src 'self' blob: data:; style-src 'self'; object-src 'none'; "
    "base-uri 'none'; form-action 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-cache",
}
_LOOPBACK = {"127.0.0.1", "localhost", "::1"}


def make_app(first: Drawing, executor: Executor, *, host: str, read_only: bool = False) -> Starlette:
    """Return the ASGI application that serves the page of a drawing.

    `first`: initial drawing; `executor`: workers that compute replies; `host`: address of the server; `read_only`:
    whether visitors can only change the Dirichlet weight k and the starts.
    """
    served = set[WebSocket]()

    async def serve(socket: WebSocket) -> None:
        if not _is_own(socket):
            await socket.close(code=1008, reason="connections from other sites are not allowed")
        elif len(served) >= MAX_BROWSERS:
            await socket.close(code=1013, reason=f"the limit of {MAX_BROWSERS} browsers is reached; close another one")
        else:
            served.add(socket)
            try:
                await socket.accept()
                await _talk(socket, first, read_only, executor)
            finally:
                served.remove(socket)

    async def index(_request: Request) -> Response:
        return FileResponse(STATIC / "index.html")

    return Starlette(
        routes=[Route("/", index), Mount("/static", StaticFiles(directory=STATIC)), WebSocketRoute("/ws", serve)],
        middleware=[Middleware(_Guard, names=_LOOPBACK | {host})],
    )


class _Guard:
    """Middleware that rejects requests with a foreign host name and adds security headers to responses.

    A foreign name that resolves to this server belongs to an attack by another site (DNS rebinding).  `app`: wrapped
    application; `names`: accepted host names.
    """

    def __init__(self, app: ASGIApp, names: Collection[str]) -> None:
        self.app, self.names = app, names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                extra = [(key.encode(), value.encode()) for key, value in _HEADERS.items()]
                message = {**message, "headers": [*message["headers"], *extra]}
            await send(message)

        address = (scope.get("server") or ("",))[0]
        if scope["type"] != "lifespan" and _name_in(Headers(scope=scope)) not in {*self.names, address}:
            await PlainTextResponse("unknown host name: open the page by its printed address", 400)(
                scope, receive, sending
            )
        else:
            await self.app(scope, receive, sending)


def _name_in(headers: Headers) -> str | None:
    """Return the host name, without the port, in the headers of a request; None if it is missing or invalid."""
    try:
        return urlsplit(f"//{headers.get('host', '')}").hostname
    except ValueError:
        return None


def _is_own(socket: WebSocket) -> bool:
    """Return whether a WebSocket was opened by the page itself instead of by another site in the same browser."""
    return urlsplit(socket.headers.get("origin", "")).netloc == socket.headers.get("host")


async def _talk(socket: WebSocket, first: Drawing, read_only: bool, executor: Executor) -> None:
    """Answer the requests of one browser, one after the other, until this browser disconnects.

    Transients are computed in parallel to other requests, one at a time, so that changes of the drawing do not wait for
    them. `socket`: connection to the browser; `first`: initial drawing; `read_only`: whether the visitor can only
    change the Dirichlet weight k and the starts; `executor`: workers that compute replies.
    """
    loop = asyncio.get_running_loop()
    sending = asyncio.Lock()
    transient: asyncio.Task[None] | None = None
    session: Session | None = None

    async def answer(talk: Session, message: bytes) -> None:
        reply = await loop.run_in_executor(executor, talk.answer, message)
        async with sending:
            await socket.send_bytes(reply)

    try:
        session = await loop.run_in_executor(executor, _begin, first, read_only)
        await socket.send_bytes(await loop.run_in_executor(executor, session.hello))
        while True:
            message = await socket.receive_bytes()
            if not session.requests_transient(message):
                await answer(session, message)
                continue
            if transient is not None:
                await transient
            session.begin_transient()
            transient = asyncio.create_task(answer(session, message))
    except (WebSocketDisconnect, KeyError):  # connection closed, or a text message, which the page never sends
        return
    finally:
        if session is not None:
            session.leave()
        if transient is not None:
            await asyncio.gather(transient, return_exceptions=True)


def _begin(first: Drawing, read_only: bool) -> Session:
    from resgrid.live_page.session import Session

    return Session(first, read_only)
