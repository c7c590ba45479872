"""The page in a notebook: the comm of a real Jupyter kernel, and the widget's module in Chromium.

Tests internals: `resgrid.live_page.drawing`, `resgrid.live_page.notebook`, `resgrid.live_page.session`.
"""

from __future__ import annotations

import base64
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from jupyter_client.blocking.client import BlockingKernelClient
from jupyter_client.manager import start_new_kernel
from playwright.sync_api import Browser
from support.pages import PATIENCE, about, read, written

import resgrid as rg
from resgrid.live_page.drawing import blank
from resgrid.live_page.notebook import LiveWidget
from resgrid.live_page.session import Session


@pytest.fixture(scope="module")
def kernel() -> Iterator[BlockingKernelClient]:
    """A client of a running Jupyter kernel."""
    manager, client = start_new_kernel(startup_timeout=PATIENCE)
    yield client
    client.stop_channels()
    manager.shutdown_kernel(now=True)


def output(client: BlockingKernelClient, kind: str) -> dict[str, Any]:
    """Return the next published message of a kind; fail on an error message."""
    while True:
        message = client.get_iopub_msg(timeout=PATIENCE)
        assert message["msg_type"] != "error", message["content"]
        if message["msg_type"] == kind:
            return dict(message)


@pytest.mark.slow
def test_rg_live_displays_a_widget_and_the_kernel_answers_requests(kernel: BlockingKernelClient):
    kernel.execute("import resgrid as rg\nrg.live()")
    opened = output(kernel, "comm_open")
    while "_esm" not in opened["content"]["data"].get("state", {}):
        opened = output(kernel, "comm_open")
    shown = output(kernel, "execute_result")
    assert "application/vnd.jupyter.widget-view+json" in shown["content"]["data"]
    content = {"comm_id": opened["content"]["comm_id"], "data": {"method": "custom", "content": {"view": "7"}}}

    def answer(*buffers: bytes) -> tuple[dict[str, Any], bytes]:
        message = kernel.session.msg("comm_msg", content)
        kernel.session.send(kernel.shell_channel.socket, message, buffers=list(buffers))
        reply = output(kernel, "comm_msg")
        assert reply["content"]["data"]["content"] == {"view": "7"}
        return read(bytes(reply["buffers"][0]))

    assert "rooms" in [example["name"] for example in answer()[0]["hello"]["examples"]]
    request, body = about("solve", blank(8), exact=True)
    head, _ = answer(written({"seq": 1, **request}, body))
    assert head["exact"] and head["paths"][0]["outcome"] == "reached"


@pytest.mark.slow
def test_the_widget_module_renders_the_page_and_solves_over_a_comm(chromium: Browser):
    context = chromium.new_context(viewport={"width": 1000, "height": 700})
    page, session = context.new_page(), Session(blank(16), read_only=False)
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))

    def answer(request: str) -> str:
        message = base64.b64decode(request)
        return base64.b64encode(session.answer(message) if message else session.hello()).decode()

    page.expose_function("answer", answer)
    page.set_content("<label for=k>not the page's</label><div id=one></div>")
    page.evaluate(
        """async (source) => {
            const url = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
            const { default: widget } = await import(url);
            const calls = new Set();
            const model = {
                on: (name, call) => calls.add(call),
                off: (name, call) => calls.delete(call),
                send: async ({ view }, callbacks, buffers = []) => {
                    const text = await window.answer(btoa(String.fromCharCode(...(buffers[0] ?? []))));
                    const data = new DataView(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
                    for (const call of calls) call({ view }, [data]);
                },
            };
            window.end = await widget.render({ model, el: document.getElementById("one") });
            window.calls = calls;
        }""",
        LiveWidget(blank(16))._esm,
    )
    until_certified = (
        "document.getElementById('one').shadowRoot.getElementById('quality').dataset.state === 'certified'"
    )
    page.wait_for_function(until_certified, timeout=1000 * PATIENCE)
    page.locator("#k").fill("0")
    page.wait_for_function("document.getElementById('one').shadowRoot.getElementById('k-out').textContent === '0'")
    page.wait_for_function(until_certified, timeout=1000 * PATIENCE)
    assert page.evaluate("window.end(), window.calls.size") == 0
    assert not wrong
    context.close()


def test_without_anywidget_rg_live_raises_tool_missing_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "resgrid.live_page.notebook", None)
    with pytest.raises(rg.ToolMissingError, match="anywidget"):
        rg.live(widget=True)
