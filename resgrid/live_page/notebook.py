"""The live page as a notebook widget (anywidget), whose session runs in the kernel without a server."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import anywidget

from resgrid.live_page.drawing import Drawing
from resgrid.live_page.session import Session

_STATIC = Path(__file__).parent / "static"
_LOADER = """
const sources = %s, urls = {};
function urlOf(name) {
  const source = () => sources[name].replace(/from "\\.\\/([\\w.]+)"/g, (_, other) => `from "${urlOf(other)}"`);
  return (urls[name] ??= URL.createObjectURL(new Blob([source()], { type: "text/javascript" })));
}
const { show } = await import(urlOf("widget.js"));
export default { render: (context) => show(context, sources["page.css"]) };
"""
"""Template of a JavaScript module that contains the sources of all modules of the page, because a widget has only one
module and no address from which others could be imported.  ``%s`` stands for a JSON object of the sources by file name.
"""


@cache
def _module() -> str:
    sources = {file.name: file.read_text(encoding="utf-8") for file in sorted(_STATIC.glob("*.*s"))}
    return _LOADER % json.dumps(sources)


class LiveWidget(anywidget.AnyWidget):
    """The live page as a notebook widget; every view (displayed copy of the widget) has its own session.

    Messages contain the name of the view and a request, in the format of messages over a WebSocket.  A message without
    a request reports that the view was opened or closed.
    """

    def __init__(self, drawing: Drawing, *, read_only: bool = False) -> None:
        super().__init__(_esm=_module())
        self._first, self._read_only = drawing, read_only
        self._sessions: dict[str, Session] = {}
        self.on_msg(self._answer)

    def _answer(self, _widget: Any, content: dict[str, Any], buffers: Sequence[Any]) -> None:
        view = str(content.get("view"))
        if content.get("end"):
            self._sessions.pop(view, None)
            return
        if not buffers:
            self._sessions[view] = Session(self._first, self._read_only)
            reply = self._sessions[view].hello()
        else:
            reply = self._sessions[view].answer(bytes(buffers[0]))
        self.send({"view": view}, [reply])
