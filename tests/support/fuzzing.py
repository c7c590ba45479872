"""Random actions on the live page by mouse, touch and keyboard; seeded."""

from __future__ import annotations

import base64
import json
import random
import zlib
from collections.abc import Callable
from typing import Any

from playwright.sync_api import Page

KEYS = (
    "Control+z", "Control+y", "Control+z", "ArrowUp", "ArrowLeft", "ArrowRight", "Shift+ArrowLeft", "Shift+ArrowDown",
    " ", "Enter", "Escape", "Tab", "Delete", *"webfmgsx?",
)  # fmt: skip
SIZES = ((1280, 720), (390, 844), (1024, 600), (700, 300))

_PLACE = """([selector, which]) => {
    const root = document.querySelector("dialog[open]") ?? document;
    const all = [...root.querySelectorAll(selector)].filter((one) => !one.disabled && one.checkVisibility());
    const one = all[Math.floor(which * all.length)];
    if (!one) return null;
    one.scrollIntoView({ block: "nearest" });
    const { x, y, width, height } = one.getBoundingClientRect();
    return [x, y, width, height];
}"""
_CHOOSE = """([selector, which, option]) => {
    const root = document.querySelector("dialog[open]") ?? document;
    const all = [...root.querySelectorAll(selector)].filter((one) => !one.disabled && one.checkVisibility());
    const one = all[Math.floor(which * all.length)];
    if (!one) return;
    one.selectedIndex = Math.floor(option * one.options.length);
    for (const kind of ["input", "change"]) one.dispatchEvent(new Event(kind, { bubbles: true }));
}"""

Box = tuple[float, float, float, float]
Action = Callable[[Page, random.Random], None]


def _place(page: Page, rng: random.Random, selector: str) -> Box | None:
    """Return left, top, width and height of a random enabled control."""
    box: Box | None = page.evaluate(_PLACE, [selector, rng.random()])
    return box


def _inside(rng: random.Random, box: Box, beyond: float = 0.0) -> tuple[float, float]:
    x, y, width, height = box
    return x + width * rng.uniform(-beyond, 1 + beyond), y + height * rng.uniform(-beyond, 1 + beyond)


def drag(page: Page, rng: random.Random) -> None:
    """Drag over a canvas."""
    box = _place(page, rng, "main canvas")
    if box is None:
        return
    page.mouse.move(*_inside(rng, box, 0.05))
    page.mouse.down(button=rng.choice(["left"] * 9 + ["right"]))
    for _ in range(rng.randrange(4)):
        page.mouse.move(*_inside(rng, box, 0.05), steps=rng.randrange(1, 6))
    if rng.random() < 0.1:
        page.keyboard.press(rng.choice(KEYS))
    page.mouse.up(button="left")
    page.mouse.up(button="right")


def touch_handle(page: Page, rng: random.Random) -> None:
    """Drag a goal or a start."""
    where = page.evaluate(
        """(which) => {
            const { scene } = live.model, { view } = live;
            const goals = scene.goals.map((goal) => view.goalPoint(goal));
            const all = [...goals, ...scene.starts.map((start) => view.startPoint(start))];
            if (!all.length) return null;
            const around = view.canvas.getBoundingClientRect(), ratio = view.canvas.width / around.width;
            const [x, y] = view.toPixels(all[Math.floor(which * all.length)]);
            return [around.left + x / ratio, around.top + y / ratio];
        }""",
        rng.random(),
    )
    if where is None:
        return
    page.mouse.move(*where)
    page.mouse.down()
    for _ in range(rng.randrange(3)):
        page.mouse.move(where[0] + rng.uniform(-200, 200), where[1] + rng.uniform(-200, 200), steps=4)
    page.mouse.up()


def press_button(page: Page, rng: random.Random) -> None:
    """Press a button, a check box, or a position on a slider."""
    box = _place(page, rng, "button, input[type=checkbox], input[type=range], summary")
    if box is not None:
        page.mouse.click(*_inside(rng, box, -0.1))


def choose(page: Page, rng: random.Random) -> None:
    """Select an entry of a list."""
    page.evaluate(_CHOOSE, ["select", rng.random(), rng.random()])


def open_example(page: Page, rng: random.Random) -> None:
    """Open an example."""
    if not page.evaluate("Boolean(document.querySelector('dialog[open]'))"):
        page.evaluate("document.getElementById('examples').click()")
    press_button(page, rng)


def write_number(page: Page, rng: random.Random) -> None:
    """Type text into a number field."""
    box = _place(page, rng, "input[type=number], dialog input")
    if box is None:
        return
    page.mouse.click(*_inside(rng, box, -0.1))
    page.keyboard.press("Control+a")
    page.keyboard.type(rng.choice(["0", "7", "123456", "-3", "1e9", "", "e", "999999999999", "0.5"]))
    page.keyboard.press(rng.choice(["Enter", "Tab"]))


def press_key(page: Page, rng: random.Random) -> None:
    """Press keys on the canvas or on the focused element."""
    if rng.random() < 0.6 and not page.evaluate("Boolean(document.querySelector('dialog[open]'))"):
        page.locator("#canvas").focus()
    for _ in range(rng.randrange(1, 6)):
        page.keyboard.press(rng.choice(KEYS))


def hover(page: Page, rng: random.Random) -> None:
    """Move the mouse to a random position."""
    page.mouse.move(rng.uniform(0, 1280), rng.uniform(0, 720), steps=rng.randrange(1, 4))
    if rng.random() < 0.2:
        page.mouse.wheel(rng.uniform(-300, 300), rng.uniform(-300, 300))


def tap(page: Page, rng: random.Random) -> None:
    """Touch a random position."""
    box = _place(page, rng, "canvas, button, input, select, a")
    if box is not None:
        page.touchscreen.tap(*_inside(rng, box))


def resize(page: Page, rng: random.Random) -> None:
    """Resize the window, also to the size of a phone."""
    width, height = rng.choice(SIZES)
    page.set_viewport_size({"width": width, "height": height})


def open_file(page: Page, rng: random.Random) -> None:
    """Open a map or an invalid file."""
    nx, ny = rng.choice([(1, 1), (1, 9), (5, 4), (64, 48), (200, 150)])
    rows = "\n".join("".join(rng.choices(".@", [4, 1], k=nx)) for _ in range(ny))
    files: list[tuple[str, bytes]] = [
        ("m.map", f"type octile\nheight {ny}\nwidth {nx}\nmap\n{rows}\n".encode()),
        ("m.pgm", b"P5 %d %d 255\n" % (nx, ny) + rng.randbytes(nx * ny)),
        ("m.map", rng.randbytes(200)),
        ("m.toml", b"schema = 2"),
        ("m.toml", b'schema = 1\n[map]\nfile = "/etc/passwd"'),
        ("m.png", rng.randbytes(60)),
        ("m.yaml", b"image: none.png\nresolution: 1"),
        ("m.exe", b""),
    ]
    name, content = rng.choice(files)
    page.locator("#file").set_input_files({"name": name, "mimeType": "", "buffer": content})


def follow_link(page: Page, rng: random.Random) -> None:
    """Follow a link to a scene, or a damaged one."""
    cells = rng.randrange(2, 40)
    axes = [{"name": name, "lower": 0, "upper": cells, "cells": cells} for name in "xy"]
    document = {"schema": 1, "grid": {"axes": axes}, "goal": [{"cell": [0, 1]}], "starts": [[cells - 0.5, 0.5]]}
    if rng.random() < 0.2:
        document = rng.choice([{"schema": 1}, {}, {"schema": 1, "map": {"file": "x"}}])
    code = base64.urlsafe_b64encode(zlib.compress(json.dumps(document).encode())).decode().rstrip("=")
    code = code[: rng.randrange(len(code))] if rng.random() < 0.2 else code
    page.evaluate("(code) => { location.hash = `s=${code}`; }", code)


def leave_dialog(page: Page, _rng: random.Random) -> None:
    """Close the dialog that is open."""
    page.keyboard.press("Escape")


WEIGHTS: dict[Action, int] = {
    drag: 30, touch_handle: 10, press_button: 20, choose: 5, open_example: 1, write_number: 3, press_key: 12, hover: 8,
    tap: 6, resize: 1, open_file: 2, follow_link: 1, leave_dialog: 3,
}  # fmt: skip


def act(page: Page, rng: random.Random, count: int) -> None:
    """Perform random actions."""
    for action in rng.choices(list(WEIGHTS), list(WEIGHTS.values()), k=count):
        action(page, rng)


def rest(page: Page, first: Any) -> None:
    """Reset the page to a scene."""
    page.set_viewport_size({"width": 1280, "height": 720})
    page.mouse.up()
    page.evaluate(
        """async (first) => {
            for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
            history.replaceState(null, "", location.pathname + location.search);
            const { keptScene } = await import("/static/model.js");
            await live.wire.ask({ type: "probe", cell: [0, 0] }).catch(() => {});  // behind all answers on their way
            live.model.reset(keptScene(first));
            live.frames.length = 0;
        }""",
        first,
    )
