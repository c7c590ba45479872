"""Layout of the page in Chromium on desktop and phone screens: no overlapping and no truncated controls.

With ``RESGRID_PICTURES=FOLDER`` a screenshot of every state is also written, in both themes, for inspection.

Tests internals: `resgrid.live_page`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page
from support.pages import drag, example_names, open_example, point_on, settle, until

from resgrid.live_page import LivePage

SIZES = {"desk": (1280, 720), "phone": (390, 844)}
PICTURES = os.environ.get("RESGRID_PICTURES", "")

# Pairs of visible controls and texts that intersect although neither contains the other, clipped to the scroll area.
OVERLAPS = """() => {
    const dialog = document.querySelector("dialog[open]");
    const shown = (element) => {
        let { left, top, right, bottom } = element.getBoundingClientRect();
        for (let at = element.parentElement; at; at = at.parentElement) {
            if (getComputedStyle(at).overflow === "visible") continue;
            const box = at.getBoundingClientRect();
            [left, top] = [Math.max(left, box.left), Math.max(top, box.top)];
            [right, bottom] = [Math.min(right, box.right), Math.min(bottom, box.bottom)];
        }
        return { left, top, right, bottom };
    };
    const name = (element) => `${element.tagName}#${element.id} ${element.textContent.trim().slice(0, 30)}`;
    const things = [...(dialog ?? document).querySelectorAll(
        "button, select, input, label, output, h1, h2, li, p, small, canvas, #quality, #legend span, .note")]
        .filter((element) => element.checkVisibility() && !element.closest("#card, #toast"))
        .map((element) => [element, shown(element)])
        .filter(([, box]) => box.right - box.left > 1 && box.bottom - box.top > 1);
    const found = [];
    things.forEach(([one, a], n) => things.slice(n + 1).forEach(([other, b]) => {
        const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        const isNested = one.contains(other) || other.contains(one);
        if (wide > 1 && high > 1 && !isNested) found.push(`${name(one)} / ${name(other)}`);
    }));
    for (const [element] of things) {
        if (element.matches("button, label, h2, #quality") && element.scrollWidth > element.clientWidth + 1) {
            found.push(`${name(element)} is cut off`);
        }
    }
    return found;
}"""


def show_example(name: str) -> Callable[[Page], None]:
    def bring(page: Page) -> None:
        open_example(page, name)
        settle(page)

    return bring


def use_tool(label: str) -> Callable[[Page], None]:
    def bring(page: Page) -> None:
        page.locator("#tools").get_by_role("button", name=label, exact=True).click()
        drag(page, [(30, 30), (45, 45)])
        nothing = "live.view.frame === null && document.getElementById('quality').dataset.state === 'error'"
        until(page, f"live.frames.at(-1).exact && live.solved === live.model.scene || {nothing}")

    return bring


def press_button(name: str) -> Callable[[Page], None]:
    def bring(page: Page) -> None:
        page.locator("header").get_by_role("button", name=name, exact=True).click()
        until(page, "document.querySelector('dialog[open]')")

    return bring


def hover(page: Page) -> None:
    page.mouse.move(*point_on(page, (50.5, 50.5)))
    until(page, "!document.getElementById('card').hidden")


def film(page: Page) -> None:
    show_example("lesson")(page)  # the transient of a small grid shows the same controls in a tenth of the time
    page.get_by_role("button", name="Show transient").click()
    until(page, "document.getElementById('moment').value === document.getElementById('moment').max")


def complaint(page: Page) -> None:
    file = {"name": "scene.toml", "mimeType": "text/plain", "buffer": b"schema = 2\nobstacles = 4"}
    page.locator("#file").set_input_files(file)
    until(page, "!document.getElementById('toast').hidden")


def scrolled(page: Page) -> None:
    page.evaluate("document.getElementById('panel').scrollTo(0, 10000)")


def arrows(page: Page) -> None:
    page.locator("#show-arrows").check()
    page.locator("#show-dots").uncheck()
    page.wait_for_timeout(100)


def flawed(page: Page) -> None:
    page.locator("#mismatch").fill("30")
    settle(page)


def ends(page: Page) -> None:
    drag(page, [(45, 30), (45, 90)])
    page.locator("#k").fill("400")
    page.locator("#show-ends").check()
    until(page, "live.view.others.length === 2")


def keys(page: Page) -> None:
    page.locator("#canvas").focus()
    page.keyboard.press("ArrowUp")
    settle(page)


def leak(page: Page) -> None:
    page.locator("#leak").fill("40")
    settle(page)


def lattice(page: Page) -> None:
    page.select_option("#lattice", "hexagonal")
    settle(page)


TOOLS = ("Wall", "Erase", "Box", "Fill", "Mud", "Goal", "Start", "Break", "Look")
STATES: dict[str, Callable[[Page], None]] = {
    "first": settle, "tour": press_button("Help"),
    "examples": press_button("Examples"),
    "new": press_button("New"), "save": press_button("Save"), "link": press_button("Link"), "hover": hover,
    "film": film, "complaint": complaint, "scrolled": scrolled, "arrows": arrows, "flawed": flawed, "keys": keys,
    "ends": ends, "leak": leak, "lattice": lattice,
    **{f"tool-{label.lower()}": use_tool(label) for label in TOOLS},
}  # fmt: skip


RESET = """() => {
    document.querySelector("dialog[open]")?.close();
    document.getElementById("toast").hidden = true;
    document.getElementById("panel").scrollTo(0, 0);
    document.activeElement.blur();
    live.tools.choose("draw");
    live.view.cursor = null;
    const boxes = [...document.querySelectorAll("#panel input[type=checkbox]")];
    window.checked ??= boxes.map((box) => box.checked);
    boxes.forEach((box, n) => { if (box.checked !== window.checked[n]) box.click(); });
    live.model.reset(window.first ??= live.model.scene);
}"""


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("theme", ["light", "dark"] if PICTURES else ["light"])
def test_controls_and_texts_neither_overlap_nor_exceed_the_screen(
    served: LivePage, chromium: Browser, size: str, theme: str
):
    width, height = SIZES[size]
    context = chromium.new_context(viewport={"width": width, "height": height}, has_touch=size == "phone")
    page = context.new_page()
    page.goto(f"{served.url}?tour=0&theme={theme}")
    settle(page)
    names = example_names(page)
    wrong = {}
    for name, bring in (STATES | {f"example-{name}": show_example(name) for name in names}).items():
        page.mouse.move(1, 1)
        page.evaluate(RESET)
        bring(page)
        if PICTURES:
            page.screenshot(path=Path(PICTURES) / f"{name}.{size}.{theme}.png")
        wrong[name] = page.evaluate(OVERLAPS)
        if page.evaluate("document.documentElement.scrollWidth") > width:
            wrong[name].append("the page is wider than the screen")
    context.close()
    assert {name: faults for name, faults in wrong.items() if faults} == {}
