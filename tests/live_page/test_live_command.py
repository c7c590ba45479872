"""The subcommand ``resgrid live``, run as a process: output, signals, exit codes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import pytest
from support.cli import COMMAND, call
from support.pages import PATIENCE
from websockets.sync.client import connect

import resgrid as rg


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.quick_cases(1)
def test_live_prints_the_address_and_exits_with_0_at_a_signal(end):
    options = ["live", "--no-browser", "--port", "0"]
    with subprocess.Popen([*COMMAND, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("the page is at http://127.0.0.1:")
        process.send_signal(end)
        _, complaints = process.communicate(timeout=PATIENCE)
    assert (process.returncode, complaints) == (0, "")


@pytest.mark.slow
def test_an_interrupt_ends_the_server_while_a_request_is_running():
    program = (
        "import time\nfrom resgrid.live_page.session import Session\nfrom resgrid.cli import main\n"
        "Session.answer = lambda session, message: time.sleep(600)\nmain(prog_name='resgrid')\n"
    )
    words = [sys.executable, "-c", program, "live", "--no-browser", "--port", "0", "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        head = "".join(iter(process.stdout.readline, "}\n")) + "}"
        address = json.loads(head)["url"]
        with connect(address.replace("http", "ws") + "ws", origin=address.rstrip("/")) as socket:
            socket.recv(timeout=PATIENCE)
            socket.send(b"anything")
            time.sleep(0.2)
            process.send_signal(signal.SIGINT)
            _, complaints = process.communicate(timeout=PATIENCE)
    assert (process.returncode, complaints) == (0, "")


def test_a_scene_of_a_turning_robot_exits_with_2(scenes):
    result = call("live", scenes / "turning.toml", "--no-browser")
    assert result.exit_code == 2 and "3 axes" in result.stderr


def test_without_uvicorn_live_raises_tool_missing_error_and_exits_with_3(monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(rg.ToolMissingError, match=r"-m pip install .*starlette.*uvicorn.*websockets"):
        rg.live(browser=False)
    assert call("live", "--no-browser").exit_code == 3
