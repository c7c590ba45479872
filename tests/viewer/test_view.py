"""The 3-D view in Chromium with software rendering: pictures, slider, and a start that plans again.

Tests internals: `resgrid.viewer`.
"""

from __future__ import annotations

import io
import socket
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, sync_playwright
from support.pages import OPTIONS, PATIENCE, browser_program

import resgrid as rg
from resgrid.viewer import Viewer

import_module("viser")

SOFTWARE = [option for option in OPTIONS if option != "--disable-gpu"]
SOFTWARE += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]


@pytest.fixture(scope="module")
def viewer(arm_scene: rg.Scene) -> Iterator[Viewer]:
    with rg.view(arm_scene, browser=False) as view:
        yield view


@pytest.fixture(scope="module")
def page(viewer: Viewer) -> Iterator[Page]:
    """The view, shown without errors."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_program(), args=SOFTWARE)
        page = browser.new_page(viewport={"width": 1000, "height": 700})
        wrong: list[str] = []
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(viewer.url)
        page.get_by_text("along the path").wait_for(timeout=PATIENCE * 1000)
        yield page
        browser.close()
    assert not wrong


def picture(page: Page) -> np.ndarray:
    """Return the part of the page left of the controls and below the notes, RGB."""
    with Image.open(io.BytesIO(page.screenshot(clip={"x": 0, "y": 220, "width": 650, "height": 480}))) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def steady(page: Page) -> np.ndarray:
    """Return the picture after it is not blank and does not change for a second."""
    end, last = time.monotonic() + 60.0, picture(page)
    while time.monotonic() < end:
        page.wait_for_timeout(1000)
        now = picture(page)
        if np.ptp(now) > 100 and np.array_equal(now, last):
            return now
        last = now
    raise AssertionError("the picture stays blank or does not come to rest")


def planned(viewer: Viewer, before: str) -> str:
    """Return the status after it differs from `before` and no computation runs."""
    end = time.monotonic() + PATIENCE
    while viewer.panel.status.content in (before, "planning ..."):
        assert time.monotonic() < end, viewer.panel.status.content
        time.sleep(0.05)
    return str(viewer.panel.status.content)


def box_of(page: Page, number: int):
    """Return the number field of a slider, counted from the top."""
    return page.locator("input:visible").nth(number)


@pytest.mark.slow
def test_the_page_shows_robot_and_obstacles_on_a_white_ground(page: Page) -> None:
    seen = steady(page)
    assert (np.abs(seen - 255).max(axis=2) > 40).mean() > 0.02
    assert ((seen[..., 0] - seen[..., 2]) > 80).any()  # the path of the tool or the goal
    assert "reached" in page.inner_text("body")


@pytest.mark.slow
def test_the_slider_moves_the_robot(page: Page, viewer: Viewer) -> None:
    before = steady(page)
    parameter = page.get_by_role("slider").first
    parameter.focus()
    parameter.press("End")
    end = time.monotonic() + 30
    while viewer.panel.slider.value < 1.0:
        assert time.monotonic() < end
        page.wait_for_timeout(100)
    after = steady(page)
    assert (np.abs(after - before).max(axis=2) > 40).sum() > 200


@pytest.mark.slow
def test_a_slider_of_the_start_plans_again(page: Page, viewer: Viewer) -> None:
    status, before = str(viewer.panel.status.content), steady(page)
    field = box_of(page, 1)
    field.fill("-1.5")
    field.press("Enter")
    text = planned(viewer, status)
    assert "reached" in text
    assert viewer.panel.motion.configurations[0] == pytest.approx([-1.5, 0.2], abs=0.02)
    page.get_by_text(f"clearance {text.split('clearance')[1].split()[0]}").wait_for()
    assert (np.abs(steady(page) - before).max(axis=2) > 40).sum() > 200


@pytest.mark.slow
def test_the_goal_of_a_handle_is_solved_and_played(page: Page, viewer: Viewer) -> None:
    status = str(viewer.panel.status.content)
    pose = np.array([-1.0, -0.5])
    viewer.panel.handles["goal"].position = viewer.panel.task.robot.reference_point(pose.reshape(1, -1))[0]
    viewer.panel._write_sliders("goal", pose + 0.2)
    viewer.panel._dragged("goal", SimpleNamespace(phase="end"))
    assert "reached" in planned(viewer, status)
    assert viewer.panel.motion.configurations[-1] == pytest.approx(pose, abs=5e-3)
    page.get_by_role("button", name="Play").click()
    end = time.monotonic() + 60
    while viewer.panel.slider.value < 1.0:
        assert time.monotonic() < end
        page.wait_for_timeout(100)


def test_only_this_computer_has_access_and_closing_frees_the_port(arm_scene: rg.Scene, capsys) -> None:
    with rg.view(arm_scene, browser=False) as view:
        assert view.url.startswith("http://127.0.0.1:")
        port = int(view.url.rstrip("/").rpartition(":")[2])
        with pytest.raises(rg.InputError, match=f"port {port} cannot be used"):
            rg.view(arm_scene, port=port, browser=False)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(("127.0.0.1", port))
    view.close()
    assert capsys.readouterr().out == ""


def test_a_missing_package_is_named_with_the_command_that_installs_it(arm_scene, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(rg.ToolMissingError, match=r"needs viser; type: .*pip install .*viser"):
        rg.view(arm_scene, browser=False)
