"""Answers and errors of the live page's server, compared with the planner, transient analysis and Kirchhoff's law.

Tests internals: `resgrid.live_page`, `resgrid.live_page.drawing`, `resgrid.live_page.frames`,
`resgrid.live_page.messages`, `resgrid.live_page.server`, `resgrid.live_page.solving`.
"""

from __future__ import annotations

import base64
import http.client
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from urllib.parse import urlsplit
from xml.etree import ElementTree

import numpy as np
import pytest
from support.pages import PATIENCE, about, ask, dial, read, written
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

import resgrid as rg
from resgrid.live_page import LivePage
from resgrid.live_page.drawing import Drawing, blank, drawing_of
from resgrid.live_page.frames import describe, picture_of
from resgrid.live_page.messages import LARGEST
from resgrid.live_page.server import MAX_BROWSERS
from resgrid.live_page.solving import solve_drawing


def files(name: str, content: bytes) -> dict[str, object]:
    return {"type": "files", "files": [{"name": name, "data": base64.b64encode(content).decode()}]}


def fetch(served: LivePage, path: str, **headers: str) -> tuple[int, bytes]:
    with closing(http.client.HTTPConnection(urlsplit(served.url).netloc, timeout=PATIENCE)) as connection:
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as response:
            return response.status, response.read()


def test_solve_returns_a_certified_frame_and_probe_a_cell(served):
    with dial(served) as socket:
        hello, _ = read(socket.recv(timeout=PATIENCE))
        assert "rooms" in [example["name"] for example in hello["hello"]["examples"]]
        head, body = ask(socket, *about("solve", blank(16), exact=True))
        assert head["exact"] and head["paths"][0]["outcome"] == "reached"
        assert len(body) == 8 * head["paths"][0]["points"] + 256 * (2 + 4 + 1)
        reply, _ = ask(socket, {"type": "probe", "cell": [3, 4]})
        assert reply["probe"]["kind"] == "free" and len(reply["probe"]["amperes"]) == 4
        assert reply["probe"]["bits"] > 0


def test_a_probed_cell_obeys_ohms_law_with_any_drive_and_sign_of_the_supply(served):
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        for k, chip in ((0.0, None), (1.0, None), (0.0, {"supply": -3.3}), (1.0, {"supply": -3.3})):
            drawing = replace(blank(16), k=k, chip=chip)
            ask(socket, *about("solve", drawing, exact=True))
            left, right = (ask(socket, {"type": "probe", "cell": [x, 4]})[0]["probe"] for x in (3, 4))
            ohms = rg.Wiring().resistance
            assert left["volts"] - right["volts"] == pytest.approx(ohms * left["amperes"][1], rel=1e-9)
            assert left["volts"] * (chip or {"supply": 1.0})["supply"] > 0.0
        ask(socket, *about("solve", replace(drawing, k=0.5), exact=True))
        assert ask(socket, {"type": "probe", "cell": [3, 4]})[0]["probe"]["volts"] is None  # a blend of two circuits


@pytest.mark.parametrize("supply", [1.0, -3.3])
@pytest.mark.parametrize(("k", "leak"), [(0.0, 0.0), (1.0, 0.0), (0.0, 0.01), (1.0, 0.01)])
@pytest.mark.quick_cases(2)
def test_settle_agrees_with_transient_analysis_and_ends_at_the_field(served, k, leak, supply):
    drawing = replace(blank(16), k=k, leak=leak, chip={"supply": supply})
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        head, body = ask(socket, *about("settle", drawing))
        assert head["from_rest"] and np.all(np.diff(head["times"]) > 0)
        count = len(head["times"])
        pictures = np.frombuffer(body, "<u2", count * 256).reshape(-1, 16, 16)
        volts = np.frombuffer(body, "<f4", offset=2 * count * 256).reshape(-1, 16, 16)
        assert len(pictures) == len(volts) == count > 5
        frame = solve_drawing(drawing, exact=True)
        np.testing.assert_array_equal(pictures[-1], picture_of(frame)[1])  # the steady field on its own scale
        shown = frame.field.space.goal_connected & (drawing.cell == rg.Cell.FREE)
        assert np.abs(pictures[-1].astype(int) - pictures[-2])[shown].max() < 0.005 * 65535
        assert np.isnan(volts[:, drawing.cell != rg.Cell.FREE]).all()
        op = next(iter(frame.solution.operating_points.values()))
        np.testing.assert_allclose(volts[-1][shown], op.voltage[op.netlist.cells.node[shown]], rtol=1e-6)
        nodes = op.netlist.cells.free_node
        capacitors = {"capacitor_nodes": [[node, 0] for node in nodes], "capacitance": [1e-12] * len(nodes)}
        moving = rg.circuit.transient(op.netlist.replace(**capacitors), head["times"], tolerance=1e-5).voltage
        close = 2e-3 * abs(supply)
        np.testing.assert_allclose(volts[:, shown], moving[:, op.netlist.cells.node[shown]], atol=close)
        assert "blend" in ask(socket, *about("settle", replace(drawing, k=0.5)))[0]["error"]


def test_settle_starts_at_the_last_exact_field_of_another_circuit(served):
    first = replace(blank(16), k=1.0)
    walled = first.cell.copy()
    walled[5:9, 4] = rg.Cell.OBSTACLE
    second = replace(first, cell=walled)
    moved = replace(second, starts=second.starts + 2.0, title="Other starts")
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        for drawing in (first, second, moved, moved):  # neither starts nor repeated requests change the circuit
            ask(socket, *about("solve", drawing, exact=True))
        ask(socket, *about("solve", first, exact=False))  # nor does an inexact frame during a stroke
        ask(socket, *about("solve", moved, exact=True))
        head, body = ask(socket, *about("settle", moved))
        assert not head["from_rest"] and len(head["times"]) > 3
        volts = np.frombuffer(body, "<f4", offset=2 * len(head["times"]) * 256).reshape(-1, 16, 16)
        before = solve_drawing(first, exact=True).field.potential
        assert volts[0][12, 2] == pytest.approx(before[12, 2], abs=1e-3)


@pytest.mark.parametrize("name", ["problem_b", "rooms"])
def test_failed_paths_have_the_reasons_of_rg_plan(scenes, name):
    scene = rg.read_scene(scenes / f"{name}.toml")
    if name == "rooms":
        scene = scene.replace(starts=((1.5, 5.0),))
    drawing = drawing_of(scene)
    reasons = [path.reason for path in solve_drawing(drawing, exact=True).paths if path.reason]
    full = [path.reason for path in rg.plan(scene, k=drawing.k).paths() if path.reason]
    radius = "; make the robot's radius smaller" if name == "rooms" else ""  # a drawing contains cells, not the radius
    near = ", or too near to one for the robot's radius of 0.15"
    assert [reason + radius for reason in reasons] == [reason.replace(near, "") for reason in full] != []


@pytest.mark.slow
def test_a_changed_drawing_cancels_a_running_settle_request(served):
    first, other = blank(96), replace(blank(96), k=0.0)
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        for number, request in enumerate((about("settle", first), about("solve", other, exact=True)), 1):
            head, body = request
            socket.send(written({**head, "seq": number}, body))
        solved, ended = (read(socket.recv(timeout=PATIENCE))[0] for _ in range(2))
        assert solved["seq"] == 2 and solved["exact"]
        assert ended["seq"] == 1 and "the drawing has changed" in ended["error"]
        moved = replace(
            other, starts=other.starts + 2.0
        )  # starts do not change the circuit, so the transient continues
        for number, request in enumerate((about("settle", other), about("solve", moved, exact=True)), 3):
            head, body = request
            socket.send(written({**head, "seq": number}, body))
        answers = {head["seq"]: head for head, _ in (read(socket.recv(timeout=PATIENCE)) for _ in range(2))}
        assert len(answers[3]["times"]) > 5 and answers[4]["exact"]


def test_a_field_equal_to_the_last_one_settles_from_rest(served):
    first = replace(blank(16), k=1.0)
    walled = first.cell.copy()
    walled[0:4, 0:4] = rg.Cell.OBSTACLE
    walled[1, 1] = rg.Cell.FREE  # a pocket
    filled = walled.copy()
    filled[1, 1] = rg.Cell.OBSTACLE
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        for cell in (walled, filled):
            ask(socket, *about("solve", replace(first, cell=cell), exact=True))
        head, _ = ask(socket, *about("settle", replace(first, cell=filled)))
        assert head["from_rest"] and len(head["times"]) > 5


def test_currents_of_probe_obey_kirchhoff_s_current_law(served):
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        ask(socket, *about("solve", blank(16), exact=True))
        left, right, below, above = ask(socket, {"type": "probe", "cell": [5, 6]})[0]["probe"]["amperes"]
        assert abs(left + below - right - above) <= 1e-6 * max(map(abs, (left, right, below, above)))


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ({"type": "dance"}, "type"),
        ({"type": "solve"}, "needs a drawing"),
        ({"type": "probe", "cell": [1]}, "cell"),
        ({"type": "probe"}, "cell"),
        ({"type": "example", "name": "../../secret"}, "no example"),
        ({"type": "link", "document": {"schema": 1, "map": {"file": "/etc/passwd"}}}, "map file"),
        ({"type": "link", "document": {"schema": 1, "grid": {"axes": [
            {"name": "x", "lower": 0, "upper": 1, "cells": 100000},
            {"name": "y", "lower": 0, "upper": 1, "cells": 10000}]}}}, "too many to draw"),
        ({"type": "files", "files": [{"name": "../x.toml", "data": ""}]}, "opens"),
        ({"type": "files", "files": [{"name": "x.toml", "data": "!"}]}, "damaged"),
        (files("x.toml", b'schema = 1\n[map]\nfile = "/etc/passwd"'), "map file"),
        (files("x.yaml", b"image: /etc/passwd"), "drop both files"),
    ],
)  # fmt: skip
def test_invalid_requests_are_answered_with_an_error(served, head, said):
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        answer, _ = ask(socket, head)
        assert said in answer["error"] and answer["kind"] != "fault"
        assert ask(socket, *about("solve", blank(8)))[0]["exact"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda head, body: (head | {"k": float("nan")}, body), "k"),
        (lambda head, body: (head | {"axes": [head["axes"][0] | {"cells": 10**9}] * 2}, body), "too many"),
        (lambda head, body: (head | {"broken": [[8, 8, 0]]}, body), "no resistor"),
        (lambda head, body: (head | {"chip": {"mismatch": 7}}, body), "sigma"),
        (lambda head, body: (head | {"chip": {"mismatch": "much"}}, body), "sigma"),
        (lambda head, body: (head, body[:-1]), "bytes"),
        (lambda head, body: (head, b"\xff" + body[1:]), "not free, obstacle or goal"),
        (lambda head, body: (head | {"chip": {"resistance": "soft"}}, body), "resistance"),
        (lambda head, body: (head | {"goal_points": [[54, 0.5, 0.5]]}, body), "does not lie in its cell"),
    ],
)
def test_invalid_drawings_are_answered_with_an_error(served, change, said):
    request, body = about("solve", blank(8))
    drawing, body = change(request["drawing"], body)
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        answer, _ = ask(socket, {"type": "solve", "drawing": drawing}, body)
        assert said in answer["error"] and answer["kind"] != "fault"


def test_an_undriven_grid_has_the_outcome_no_current(served):
    """Without obstacles and with open edges no current flows at k = 1; the message proposes k = 0."""
    request, body = about("solve", blank(8))
    drawing = request["drawing"] | {"edge": ["open", "open"]}
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        (path,) = ask(socket, {"type": "solve", "drawing": drawing}, body)[0]["paths"]
        assert path["outcome"] == "no_current" and "k = 0" in path["message"]
        (path,) = ask(socket, {"type": "solve", "drawing": drawing | {"k": 0.5}}, body)[0]["paths"]
        assert path["outcome"] == "reached"


def test_an_oversized_message_closes_its_connection_only(served):
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        with pytest.raises(ConnectionClosed) as closed:
            socket.send(bytes(100_000_000))
            socket.recv(timeout=PATIENCE)
        assert closed.value.rcvd is None or closed.value.rcvd.code == 1009
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        assert ask(socket, *about("solve", blank(8)))[0]["exact"]
    assert LARGEST < 100_000_000


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", None])
def test_a_foreign_origin_gets_status_403(served, origin):
    with pytest.raises(InvalidStatus, match="403"), dial(served, origin=origin):
        pass


def test_a_foreign_host_header_gets_status_400(served):
    assert fetch(served, "/", Host="evil.example")[0] == 400
    assert fetch(served, "/")[0] == 200


@pytest.mark.parametrize("path", ["/static/../server.py", "/static/..%2fserver.py", "/server.py", "//etc/passwd"])
def test_files_outside_static_get_status_404(served, path):
    status, content = fetch(served, path)
    assert status == 404 and b"import" not in content


def test_a_server_on_all_interfaces_accepts_its_addresses_only():
    with rg.live(host="0.0.0.0", browser=False) as page:
        port = urlsplit(page.url).port
        assert page.url == f"http://127.0.0.1:{port}/"
        for name, status in (
            ("127.0.0.1", 200),
            ("localhost", 200),
            ("evil.example", 400),
            ("10.1.2.3", 400),
            ("[", 400),
        ):
            assert fetch(page, "/", Host=f"{name}:{port}")[0] == status
        elsewhere = f"http://127.0.0.2:{port}"
        with closing(http.client.HTTPConnection(urlsplit(elsewhere).netloc, timeout=PATIENCE)) as connection:
            connection.request("GET", "/")
            assert connection.getresponse().status == 200


def admitted(served: LivePage) -> ClientConnection:
    """Return a connection, with retries while closed ones are still counted."""
    until = time.monotonic() + 60.0
    while True:
        try:
            return dial(served)
        except InvalidStatus:
            assert time.monotonic() < until, "browsers that left are still counted"
            time.sleep(0.05)


@pytest.mark.parametrize("way", [socket.SHUT_WR, socket.SHUT_RD, socket.SHUT_RDWR])
@pytest.mark.parametrize("sent", [b"", b"\x82\xfe\x01", b"\x82\x84\0\0\0\0\xff\0\0\0"])
def test_half_closed_sockets_do_not_block_other_browsers(served, way, sent):
    address = urlsplit(served.url)
    greeting = (
        f"GET /ws HTTP/1.1\r\nHost: {address.netloc}\r\nOrigin: http://{address.netloc}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    for _ in range(MAX_BROWSERS + 4):
        with socket.create_connection((address.hostname, address.port), timeout=PATIENCE) as broken:
            broken.sendall(greeting.encode())
            assert broken.recv(12).startswith(b"HTTP/1.1")
            with suppress(OSError):  # the server has closed those beyond MAX_BROWSERS already
                broken.sendall(sent)
                broken.shutdown(way)
    with admitted(served) as other:
        other.recv(timeout=PATIENCE)
        assert ask(other, *about("solve", blank(8)))[0]["exact"]


def test_browsers_beyond_the_limit_get_status_403(served):
    with ExitStack() as stack:
        for _ in range(MAX_BROWSERS):
            stack.enter_context(admitted(served)).recv(timeout=PATIENCE)
        with pytest.raises(InvalidStatus, match="403"):
            dial(served)
    with admitted(served) as later:
        assert "hello" in read(later.recv(timeout=PATIENCE))[0]


@pytest.mark.slow
def test_slow_and_busy_browsers_do_not_delay_other_browsers(served):
    """Small requests are answered before the request of another browser for a large grid."""
    large, small = about("solve", blank(768), exact=True), about("solve", blank(24), exact=True)
    with dial(served) as deaf, dial(served) as busy, dial(served) as quick:
        for each in (busy, quick):
            each.recv(timeout=PATIENCE)
        ask(quick, *small)
        for _ in range(20):
            deaf.send(written({"seq": 1, **about("solve", blank(96))[0]}, about("solve", blank(96))[1]))
        busy.send(written({"seq": 1, **large[0]}, large[1]))
        for _ in range(3):
            assert ask(quick, *small)[0]["exact"]
        with pytest.raises(TimeoutError):
            busy.recv(timeout=0)
        assert read(busy.recv(timeout=PATIENCE))[0]["exact"]


@pytest.mark.slow
def test_concurrent_answers_equal_those_of_solve_drawing(served):
    drawings = [replace(blank(cells), k=k) for cells in (96, 64) for k in (0.0, 1.0)]

    def picture(drawing: Drawing) -> bytes:
        with dial(served) as browser:
            browser.recv(timeout=PATIENCE)
            return [ask(browser, *about("solve", drawing))[1] for _ in range(4)][-1]

    def expected(drawing: Drawing) -> bytes:
        return b"".join(describe(solve_drawing(drawing, exact=True))[1])

    with ThreadPoolExecutor(len(drawings)) as pool:
        answers = list(pool.map(picture, drawings))
    assert answers == [expected(drawing) for drawing in drawings]


def test_every_browser_has_its_own_drawing(served):
    with dial(served) as one, dial(served) as other:
        one.recv(timeout=PATIENCE)
        other.recv(timeout=PATIENCE)
        ask(one, *about("solve", blank(8)))
        ask(other, *about("solve", replace(blank(12), k=0.0)))
        assert ask(one, {"type": "probe", "cell": [7, 7]})[0]["probe"]["kind"] == "free"
        assert "no cell" in ask(one, {"type": "probe", "cell": [11, 11]})[0]["error"]
        assert ask(other, {"type": "probe", "cell": [11, 11]})[0]["probe"]["kind"] == "free"


def test_a_read_only_page_solves_its_scene_and_rejects_other_examples():
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 8, 8), rg.Axis("y", 0, 8, 8)], np.eye(8, dtype=np.uint8) * 2)
    with rg.live(space, read_only=True, browser=False) as page, dial(page) as socket:
        assert isinstance(page, LivePage)
        assert read(socket.recv(timeout=PATIENCE))[0]["hello"]["read_only"]
        assert "read-only" in ask(socket, {"type": "example", "name": "rooms"})[0]["error"]
        head, _ = ask(socket, *about("solve", replace(blank(8), k=0.5)))
        assert head["cells"] == 56


def test_comparison_paths_equal_those_of_the_ideal_chip_and_of_k_1(served):
    drawing = replace(blank(16), k=0.5, broken=((5, 5, 0),), chip={"mismatch": 0.1, "seed": 3})
    others = replace(drawing, broken=(), chip={}), replace(drawing, k=1.0)
    expected = b"".join(describe(solve_drawing(other, exact=True))[1][0] for other in others)
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        head, body = ask(socket, *about("paths", drawing, paths=["ideal", "k = 1"]))
        assert body == expected and 8 * sum(map(sum, head["points"])) == len(body)
        driven = replace(drawing, k=0.0, driven=True)
        assert "uniform drive" in ask(socket, *about("paths", driven, paths=["k = 0"]))[0]["error"]
        assert "paths" in ask(socket, *about("paths", drawing, paths=["worst"]))[0]["error"]


def test_save_returns_a_scene_a_path_table_or_a_zip_of_decks(served):
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        head, content = ask(socket, *about("save", blank(8), format="toml"))
        assert head["name"] == "scene.toml" and rg.parse_scene(content.decode()).ndim == 2
        head, content = ask(socket, *about("save", blank(8), format="csv"))
        assert content.startswith(b"path,") and head["name"] == "paths.csv"
        head, content = ask(socket, *about("save", blank(8), format="deck"))
        assert content.startswith(b"PK") and b"dirichlet.cir.json" in content


def test_elements_of_a_small_circuit_obey_ohm_and_kirchhoff():
    drawing = replace(blank(8), chip={"mismatch": 0.2, "seed": 3})
    circuit = describe(solve_drawing(drawing, exact=True))[0]["circuit"]
    into = np.zeros((10, 10))  # padded for the rails
    for axis, i, j, ohms, volts, amperes in circuit["resistors"]:
        assert volts == pytest.approx(ohms * amperes)
        into[i + 1, j + 1] += amperes
        into[(i, j + 1) if axis == 0 else (i + 1, j)] -= amperes
    given = {supply["rail"]: supply["amperes"] for supply in circuit["supplies"]}
    assert into[7, 7] == pytest.approx(-given["goal 0"]) and given["obstacles"] == pytest.approx(-given["goal 0"])
    inside = into[1:-1, 1:-1].copy()
    inside[6, 6] = 0.0
    assert np.abs(inside).max() <= 1e-9 * given["obstacles"]
    assert describe(solve_drawing(blank(11), exact=True))[0]["circuit"] is None


@pytest.mark.slow
def test_save_returns_svg_of_the_field_and_of_small_circuits(served):
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        for kind in ("svg", "circuit"):
            _, content = ask(socket, *about("save", blank(8), format=kind))
            assert ElementTree.fromstring(content).tag.endswith("svg")
        assert "up to 10" in ask(socket, *about("save", blank(12), format="circuit"))[0]["error"]


def test_truncated_messages_are_answered_with_an_error(served):
    with dial(served) as socket:
        socket.recv(timeout=PATIENCE)
        for message in (b"", b"\xff\xff\xff\xff", b"\x02\0\0\0[]", b"\x02\0\0\0{", written({"seq": 1})):
            socket.send(message)
            assert "error" in read(socket.recv(timeout=PATIENCE))[0]


def test_a_port_in_use_raises_input_error(served):
    port = urlsplit(served.url).port
    with pytest.raises(rg.InputError, match="--port"):
        rg.live(port=port, browser=False)
