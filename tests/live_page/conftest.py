from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from playwright.sync_api import Browser, Page, sync_playwright
from support.pages import OPTIONS, browser_program, settle

import resgrid as rg
from resgrid.live_page import LivePage
from resgrid.live_page.drawing import blank
from resgrid.live_page.solving import solve_drawing


@pytest.fixture(scope="module")
def served() -> Iterator[LivePage]:
    """A page with an empty square, served after its kernels are compiled."""
    for exact in (True, False):
        for k in (0.0, 1.0):
            solve_drawing(replace(blank(), k=k), exact=exact)
    with rg.live(browser=False) as page:
        yield page


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """Chromium, started once per file."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_program(), args=OPTIONS)
        yield browser
        browser.close()


@pytest.fixture
def shown(served: LivePage, chromium: Browser) -> Iterator[Page]:
    """The solved page in a browser context of its own; console errors fail the test."""
    context = chromium.new_context(viewport={"width": 1280, "height": 720})
    page = context.new_page()
    wrong: list[str] = []
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(f"{served.url}?tour=0")
    settle(page)
    yield page
    context.close()
    assert not wrong
