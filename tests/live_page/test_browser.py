"""The live page in Chromium, operated by mouse, touch and keyboard; paths agree with ``resgrid path``.

Tests internals: `resgrid._internal.colours`, `resgrid.live_page`, `resgrid.plot.style`.
"""

from __future__ import annotations

import io
import json
import random

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page
from support.cli import answer
from support.pages import drag, example_names, kept, lines, link_of, open_example, point_on, settle, until

import resgrid as rg
from resgrid._internal.colours import GOAL
from resgrid.live_page import LivePage
from resgrid.plot.style import height_map

# Two seconds of a browser's processor time per test; test_notebook.py opens the page in every run.
pytestmark = pytest.mark.slow

PIXELS = "live.view.canvas.toDataURL()"
WALL = "live.model.scene.cells.reduce((sum, byte) => sum + (byte & 1), 0)"


def stop_motion(page: Page) -> None:
    """Stop the animation of a page and wait until it is painted."""
    page.mouse.move(1, 1)
    page.evaluate("live.view.shows.dots = false; live.view.pinned = null")
    page.wait_for_timeout(200)


def test_undo_restores_the_drawing_byte_for_byte(shown: Page):
    first = kept(shown)
    shown.locator("#brush").fill("1")
    drag(shown, [(40, 20), (40, 70)])
    settle(shown)
    assert shown.evaluate(WALL) == 51
    assert "✓ certified" in shown.inner_text("#quality")
    drag(shown, [(40, 40), (40, 44)])
    assert shown.evaluate(WALL) == 46  # a stroke that begins on a wall erases
    shown.get_by_role("button", name="Box").click()
    drag(shown, [(5, 5), (9, 8)])
    assert shown.evaluate(WALL) == 66
    shown.get_by_role("button", name="Fill").click()
    drag(shown, [(6, 6)])  # all walls that are joined
    settle(shown)
    assert shown.evaluate(WALL) == 46
    drawn = kept(shown)
    for _ in range(4):
        shown.get_by_role("button", name="Undo").click()
    settle(shown)
    assert kept(shown) == first
    assert shown.get_by_role("button", name="Undo").is_disabled()
    for _ in range(4):
        shown.keyboard.press("Control+y")
    assert kept(shown) == drawn


def test_goals_and_starts_are_dragged_added_and_removed_by_mouse(shown: Page):
    drag(shown, [(72, 72), (20, 72)])
    settle(shown)
    assert shown.evaluate("live.model.scene.goals") == [[20 * 96 + 72]]
    assert lines(shown)[0][-1] == pytest.approx((20.5, 72), abs=0.6)
    drag(shown, [(19, 19), (60, 10)])
    assert shown.evaluate("live.model.scene.starts[0]") == [60.5, 10.5]
    shown.get_by_role("button", name="Start").click()
    drag(shown, [(80, 80)])
    shown.get_by_role("button", name="Goal").click()
    drag(shown, [(50, 50)])
    settle(shown)
    assert shown.locator("#paths li").count() == 2
    drag(shown, [(50, 50)])
    settle(shown)
    assert shown.evaluate("live.model.scene.goals.length") == 1
    drag(shown, [(20, 72)])
    until(shown, "document.getElementById('quality').textContent.includes('no goal')")


def test_controls_for_k_wall_and_edge_change_the_field(shown: Page):
    drag(shown, [(30, 10), (30, 60)])
    settle(shown)
    repelled = lines(shown)[0]
    shown.locator("#k").fill("0")
    settle(shown)
    assert shown.evaluate("live.model.scene.k") == 0
    assert not np.array_equal(lines(shown)[0], repelled)
    shown.locator("#wall").fill("30")
    settle(shown)
    shown.select_option("#edge", "open")
    settle(shown)
    shown.select_option("#driven", "start")
    settle(shown)
    assert shown.locator("#k").is_disabled()


def test_the_leak_slider_states_its_unit_and_the_screening_length(shown: Page):
    assert shown.inner_text("#leak-out") == "none"
    shown.locator("#k").fill("0")
    settle(shown)
    assert shown.inner_text("#legend-low") == "goal: potential 0"
    shown.locator("#leak").fill("30")
    settle(shown)
    leak = shown.evaluate("live.model.scene.leak")
    assert shown.inner_text("#leak-out") == f"{leak:g} / cell²"
    ohms, length = 10e3 / leak, leak**-0.5
    assert f"screening length {length:.3g} cell; {ohms / 1e6:.3g} MΩ from every node" in shown.inner_text("#leak-note")
    assert "✓ certified" in shown.inner_text("#quality") and "decades" in shown.inner_text("#legend-high")
    drive = shown.locator("#driven")  # open obstacles are driven by the leak
    assert drive.is_disabled() and "set it to none" in (drive.get_attribute("title") or "")
    shown.get_by_role("button", name="Undo").click()
    until(shown, "document.getElementById('leak-out').textContent === 'none'")
    assert drive.is_enabled() and not drive.get_attribute("title")
    shown.select_option("#driven", "start")
    settle(shown)
    for control in ("k", "wall", "leak"):
        assert shown.locator(f"#{control}").is_disabled()
        assert "choose the uniform drive" in (shown.locator(f"#{control}").get_attribute("title") or "")


def test_the_ends_of_the_leak_slider_are_one_cell_and_twice_the_grid(shown: Page):
    for place, length in (("1", 192.0), ("60", 1.0)):
        shown.locator("#leak").fill(place)
        settle(shown)
        assert shown.evaluate("live.model.scene.leak ** -0.5") == pytest.approx(length, rel=0.01)
        assert shown.locator("#leak").input_value() == place


def test_a_lattice_shows_the_path_from_node_to_node_and_disables_what_needs_squares(shown: Page):
    smooth = lines(shown)[0]
    shown.select_option("#lattice", "square8")
    settle(shown)
    line = lines(shown)[0]
    steps = np.abs(np.diff(line, axis=0))
    assert not np.array_equal(line, smooth)
    np.testing.assert_allclose(steps[:-1] * (steps[:-1] - 1), 0, atol=1e-6)  # whole cells: 0 or 1 along each axis
    assert "✓ certified" in shown.inner_text("#quality")
    assert "from node to node" in shown.inner_text("#lattice-note")
    for control in ("#leak", "#mismatch", "#seed", "#settle"):
        assert shown.locator(control).is_disabled(), control
        assert "4 neighbours" in (shown.locator(control).get_attribute("title") or ""), control
    snap = shown.get_by_role("button", name="Break")
    assert snap.is_disabled() and "4 neighbours" in (snap.get_attribute("title") or "")
    shown.locator("#canvas").focus()
    shown.keyboard.press("x")  # the key of a disabled tool
    assert shown.evaluate("live.tools.tool") == "draw"
    shown.mouse.move(*point_on(shown, (50.5, 50.5)))
    until(shown, "document.getElementById('card').textContent.includes('next')")
    assert "the largest current density leads to a lower potential" in shown.inner_text("#card")
    drag(shown, [(40, 20), (40, 60)])
    settle(shown)
    assert "✓ certified" in shown.inner_text("#quality")
    for _ in range(2):
        shown.get_by_role("button", name="Undo").click()
    settle(shown)
    np.testing.assert_array_equal(lines(shown)[0], smooth)
    settle_button = shown.locator("#settle")
    assert settle_button.is_enabled() and "Transient" in (settle_button.get_attribute("title") or "")


def test_mismatch_open_resistors_and_leaks_disable_the_lattice(shown: Page):
    lattice = shown.locator("#lattice")
    for change, said in (
        ("{ chip: { mismatch: 0.1, seed: 1 } }", "set the mismatch to none"),
        ("{ broken: [[3, 4, 0]] }", "repair the resistors"),
        ("{ leak: 0.1 }", "leak"),
    ):
        assert lattice.is_enabled()
        shown.evaluate(f"live.model.replace({change})")
        settle(shown)
        assert lattice.is_disabled() and said in (lattice.get_attribute("title") or "")
        shown.get_by_role("button", name="Undo").click()


def test_the_circuit_of_a_lattice_is_drawn_and_its_link_opens_it(shown: Page, chromium: Browser):
    open_example(shown, "lesson")
    shown.select_option("#lattice", "hexagonal")
    settle(shown)
    segments = shown.evaluate("live.view.frame.circuit.segments")
    a, b, c, d, ohms = segments[len(segments) // 2][:5]
    shown.mouse.move(*point_on(shown, ((a + c) / 2, (b + d) / 2)))
    until(shown, "document.getElementById('card').textContent.includes('resistor')")
    assert f"{ohms / 1e3:g} kΩ" in shown.inner_text("#card")
    other = chromium.new_context().new_page()
    other.goto(link_of(shown).replace("/#", "/?tour=0#"))
    until(other, "live.model.scene && live.model.scene.lattice === 'hexagonal'")
    settle(other)
    np.testing.assert_array_equal(lines(other)[0], lines(shown)[0])
    other.context.close()


def test_paths_of_k_0_and_k_1_are_shown_on_request(shown: Page):
    shown.locator("#brush").fill("1")
    drag(shown, [(30, 10), (30, 60)])
    settle(shown)
    repelled = lines(shown)[0]
    shown.locator("#show-ends").check()
    until(shown, "live.view.others.length === 2")
    ends = shown.evaluate("live.view.others.map(({ lines }) => Array.from(lines[0]))")
    assert np.array_equal(np.reshape(ends[1], (-1, 2)), repelled)
    shown.locator("#k").fill("0")
    settle(shown)
    assert np.array_equal(np.reshape(ends[0], (-1, 2)), lines(shown)[0])
    assert shown.evaluate("live.view.others.length") == 2
    drag(shown, [(60, 10), (60, 20)])
    settle(shown)
    until(shown, "live.view.others.length === 2 && live.view.others[0].scene === live.model.scene")
    shown.locator("#show-ends").uncheck()
    until(shown, "live.view.others.length === 0")


def test_the_path_shown_equals_the_path_of_the_shared_link(shown: Page):
    rng = random.Random(7)
    for _ in range(20):
        cells = np.zeros((96, 96), np.uint8)
        for _ in range(rng.randrange(4, 20)):
            i, j = rng.randrange(90), rng.randrange(90)
            cells[i : i + rng.randrange(1, 30), j : j + rng.randrange(1, 12)] = 1
        cells[70:75, 70:75] = 0
        change = {"k": rng.choice([0, 0.3, 0.99, 1]), "wall": rng.choice([0, 0, 3000])}
        shown.evaluate(
            """([cells, change]) => live.model.replace(
                { ...live.model.scene, ...change, cells: Uint8Array.from(cells) })""",
            [cells.ravel().tolist(), change],
        )
        settle(shown)
        line = lines(shown)[0]
        paths = answer("path", link_of(shown), code=0 if len(line) else 1)["paths"]
        assert len(paths) == 1
        assert paths[0]["outcome"] == shown.evaluate("live.view.frame.paths[0].outcome")
        if len(line):
            assert len(paths[0]["cells"]) == shown.evaluate("live.view.frame.paths[0].cells")
            np.testing.assert_allclose(line, paths[0]["points"], atol=1e-4)
            inner = np.floor((line[:-1] + line[1:]) / 2)[np.abs(np.diff(line, axis=0)).sum(axis=1) > 1e-3]
            assert {tuple(cell) for cell in inner.tolist()} <= {tuple(cell) for cell in paths[0]["cells"]}


def test_a_defective_chip_is_shown_with_the_ideal_path(shown: Page):
    shown.get_by_role("button", name="Break").click()
    before = lines(shown)[0]
    middle = before[len(before) // 2]
    shown.mouse.click(*point_on(shown, (np.floor(middle[0]) + 0.97, np.floor(middle[1]) + 0.5)))
    settle(shown)
    assert shown.evaluate("live.model.scene.broken.length") == 1
    until(shown, "live.view.others.length === 1")
    ideal = np.reshape(shown.evaluate("Array.from(live.view.others[0].lines[0])"), (-1, 2))
    np.testing.assert_array_equal(ideal, before)
    assert not np.array_equal(lines(shown)[0], before)  # the path flips
    shown.locator("#mismatch").fill("30")
    settle(shown)
    first = lines(shown)[0]
    shown.locator("#seed").fill("7")
    shown.keyboard.press("Enter")
    until(shown, "live.model.scene.chip.seed === 7")
    settle(shown)
    assert not np.array_equal(lines(shown)[0], first)
    shown.locator("#mismatch").fill("0")
    shown.get_by_role("button", name="Undo").click()
    shown.get_by_role("button", name="Undo").click()
    until(shown, "live.model.before === null")


def test_the_transient_plays_to_the_steady_field_and_ends_at_an_edit(shown: Page):
    shown.locator("#k").fill("0")
    settle(shown)
    legend = shown.inner_text("#legend")
    stop_motion(shown)
    field = shown.evaluate(PIXELS)
    shown.get_by_role("button", name="Show transient").click()
    until(shown, "!document.getElementById('film').hidden")
    until(shown, "document.getElementById('moment').value === document.getElementById('moment').max")
    assert shown.inner_text("#origin") == "from the field before the last change"
    assert shown.inner_text("#time").endswith("settled")
    assert shown.inner_text("#legend") == legend
    shown.locator("#moment").fill("0")
    assert shown.inner_text("#time").endswith("s")
    shown.get_by_role("button", name="Look").click()
    shown.mouse.move(*point_on(shown, (50.5, 50.5)))
    until(shown, "document.getElementById('card').textContent.includes('V at')")
    early = shown.inner_text("#card")
    shown.locator("#moment").fill("12")
    shown.mouse.move(*point_on(shown, (50.5, 50.6)))
    until(shown, "document.getElementById('card').textContent.includes('V at')")
    assert shown.inner_text("#card") != early
    stop_motion(shown)
    moment, light = shown.evaluate(PIXELS), shown.evaluate("document.getElementById('scope').toDataURL()")
    shown.get_by_role("button", name="Dark or light").click()
    assert shown.evaluate("document.getElementById('scope').toDataURL()") != light
    shown.get_by_role("button", name="Dark or light").click()
    shown.wait_for_timeout(200)
    assert shown.evaluate(PIXELS) == moment  # another theme shows the same moment
    shown.locator("#moment").fill("100")
    shown.mouse.move(*point_on(shown, (50.5, 50.5)))
    until(shown, "document.getElementById('card').textContent.includes('converter bits')")
    shown.mouse.click(*point_on(shown, (50.5, 50.5)))
    assert shown.evaluate("live.view.pinned") == [50, 50]
    assert shown.locator("#film").is_visible()  # inspecting a cell is no edit
    shown.get_by_role("button", name="Wall", exact=True).click()
    drag(shown, [(30, 30), (30, 40)])
    settle(shown)
    assert shown.locator("#film").is_hidden()
    shown.get_by_role("button", name="Undo").click()
    settle(shown)
    shown.mouse.click(*point_on(shown, (50.5, 50.5)))
    shown.get_by_role("button", name="Undo").click()
    settle(shown)
    stop_motion(shown)
    assert shown.evaluate(PIXELS) == field


def test_an_example_is_solved_once(shown: Page):
    settle(shown)
    frames = shown.evaluate("live.frames.length")
    open_example(shown, "ring")
    settle(shown)
    shown.wait_for_timeout(500)
    assert shown.evaluate("live.frames.length") == frames + 1


def test_actions_without_an_edit_keep_history_frames_and_transient(shown: Page):
    open_example(shown, "ring")
    until(shown, "live.model.scene.title === 'Ring'")
    settle(shown)
    past, frames = shown.evaluate("live.model.past.length"), shown.evaluate("live.frames.length")
    shown.get_by_role("button", name="Show transient").click()
    until(shown, "!document.getElementById('film').hidden")
    for tool in ("Look", "Erase"):
        shown.locator("#tools").get_by_role("button", name=tool).click()
        drag(shown, [(5, 20), (8, 20)])
    start = shown.evaluate("live.view.startPoint(live.model.scene.starts[0]).map(Math.floor)")
    drag(shown, [tuple(start)])  # a start pressed without a move
    shown.locator("#k").evaluate(
        "(k) => { k.dispatchEvent(new Event('input')); k.dispatchEvent(new Event('change')); }"
    )
    shown.locator("#examples").click()
    shown.locator("#choosing [data-example=ring]").click()  # the same example again
    shown.wait_for_timeout(500)
    assert shown.locator("#film").is_visible()
    assert shown.evaluate("live.model.past.length") == past
    assert shown.evaluate("live.frames.length") == frames
    assert shown.evaluate("live.model.before === null")


def test_the_title_names_the_example_and_its_changes(shown: Page):
    title = "document.getElementById('title').textContent"
    assert shown.evaluate(title) == "Drawing"
    assert shown.locator("#example").is_hidden()
    open_example(shown, "chair")
    settle(shown)
    assert shown.evaluate(title) == "Problem 2: a chair"
    assert "drag the seat" in shown.inner_text("#about")
    open_example(shown, "rooms")
    settle(shown)
    assert (shown.evaluate(title), shown.evaluate("live.model.scene.k")) == ("Rooms", 1)
    assert "all 3 paths reach a goal" in shown.inner_text("#quality")
    drag(shown, [(10, 70), (12, 70)])
    until(shown, f"{title} === 'Rooms (changed)'")
    assert shown.inner_text("#example-heading") == "In the example before your changes"
    shown.get_by_role("button", name="Undo").click()
    until(shown, f"{title} === 'Rooms'")
    for earlier in ("Problem 2: a chair", "Drawing"):  # examples are steps of the undo history
        shown.get_by_role("button", name="Undo").click()
        until(shown, f"{title} === '{earlier}'")
    assert shown.locator("#example").is_hidden()


def test_clear_walls_is_one_undo_step_and_keeps_goals_starts_and_mud(shown: Page):
    clear = shown.get_by_role("button", name="Clear walls")
    assert clear.is_disabled()  # the drawing has no walls
    open_example(shown, "rooms")
    shown.get_by_role("button", name="Mud").click()
    drag(shown, [(20, 60), (30, 60)])
    settle(shown)
    before, scene = kept(shown), shown.evaluate("live.model.scene")
    clear.click()
    settle(shown)
    after = shown.evaluate("live.model.scene")
    assert shown.evaluate(WALL) == 0 and clear.is_disabled()
    assert (after["goals"], after["starts"]) == (scene["goals"], scene["starts"])
    assert shown.evaluate("live.model.scene.cells.some((byte) => byte >> 2)")
    shown.get_by_role("button", name="Undo").click()
    settle(shown)
    assert kept(shown) == before and clear.is_enabled()


def test_the_keyboard_opens_an_example_and_the_menu_marks_the_current_one(shown: Page):
    shown.locator("#examples").focus()
    shown.keyboard.press("Enter")
    until(shown, "document.getElementById('choosing').open")
    dialog = shown.get_by_role("dialog", name="Examples")
    assert dialog.get_by_role("region").count() == 4  # groups with accessible names
    focused = "document.activeElement.dataset.example"
    assert shown.evaluate(focused) == example_names(shown)[0]
    shown.keyboard.press("Tab")
    second = shown.evaluate(focused)
    assert second == example_names(shown)[1]
    shown.keyboard.press("Enter")
    until(shown, f"live.model.scene.title === '{title_of(shown, second)}'")
    settle(shown)
    shown.locator("#examples").click()
    current = dialog.locator("[aria-current=true]")
    assert current.get_attribute("data-example") == second == shown.evaluate(focused)
    for entry in shown.evaluate("live.panel.examples"):
        assert dialog.get_by_role("button", name=f"{entry['title']} {entry['about']}", exact=True).count() == 1
    shown.keyboard.press("Escape")
    assert shown.evaluate("document.activeElement.id") == "examples"


def title_of(page: Page, name: str) -> str:
    """Return the title of an example."""
    return str(next(entry["title"] for entry in page.evaluate("live.panel.examples") if entry["name"] == name))


def test_angles_and_greek_axis_names_are_typeset(shown: Page):
    names = shown.evaluate(
        """import('/static/names.js').then(({ nameOf, tickOf, placeOf }) => {
            const angle = { name: "theta_1", unit: "rad" }, length = { name: "x", unit: "m" };
            return [nameOf(angle), nameOf({ name: "theta12" }), nameOf(length), nameOf({ name: "width_2" }),
                    ...[Math.PI, -Math.PI / 2, 4 * Math.PI / 3, 0, 1].map((value) => tickOf(value, angle)),
                    tickOf(Math.PI, length), placeOf([-Math.PI / 4, 1.5], { axes: [angle, length] })];
        })"""
    )
    assert names == ["θ₁", "θ₁₂", "x", "width_2", "π", "−π/2", "4π/3", "0", "1", "3.142", "θ₁ −45.0°, x 1.5 m"]


def test_cells_without_a_path_to_a_goal_have_a_legend(shown: Page):
    assert shown.locator("#legend-cut").is_hidden()
    shown.locator("#brush").fill("1")
    drag(shown, [(2, 2), (8, 2), (8, 8), (2, 8), (2, 2)])
    settle(shown)
    assert shown.inner_text("#legend-cut") == "no path to a goal"


def test_the_cell_card_does_not_cover_the_grid(shown: Page):
    shown.mouse.move(*point_on(shown, (90.5, 90.5)))
    until(shown, "!document.getElementById('card').hidden")
    card, grid = (shown.locator(part).bounding_box() for part in ("#card", "#canvas"))
    assert card and grid and card["x"] >= grid["x"] + grid["width"]


def test_a_link_opens_the_same_drawing_and_paths_in_another_browser(served: LivePage, chromium: Browser, shown: Page):
    open_example(shown, "ring")
    until(shown, "live.model.scene.title === 'Ring'")
    flaws = "broken: [[3, 4, 0], [5, 5, 1]], wall: 2000, leak: 0.25, chip: { mismatch: 0.1, seed: 7 }"
    shown.evaluate(f"live.model.replace({{ ...live.model.scene, {flaws} }})")
    settle(shown)
    other = chromium.new_context().new_page()
    other.goto(link_of(shown).replace("/#", "/?tour=0#"))
    until(other, "live.model.scene && live.model.scene.title === 'Ring'")
    settle(other)
    assert kept(other) == kept(shown)
    for one, same in zip(lines(other), lines(shown), strict=True):
        np.testing.assert_array_equal(one, same)
    other.context.close()


def test_the_drawing_survives_a_reload_of_the_page(shown: Page):
    drag(shown, [(30, 30), (30, 50)])
    drawn = kept(shown)
    until(shown, f"JSON.parse(localStorage.getItem('resgrid drawing') ?? '{{}}').scene === {json.dumps(drawn)}")
    shown.reload()
    settle(shown)
    assert kept(shown) == drawn


def test_every_example_opens_with_a_certified_path(shown: Page):
    names = example_names(shown)
    assert "rooms" in names
    for name in names:
        open_example(shown, name)
        settle(shown)
        assert "✓ certified" in shown.inner_text("#quality"), name


def test_a_benchmark_map_file_opens_and_a_wrong_scene_file_is_reported(shown: Page):
    rows = ["..@..", ".....", "@@@..", "....."]
    text = f"type octile\nheight {len(rows)}\nwidth 5\nmap\n" + "\n".join(rows) + "\n"
    shown.locator("#file").set_input_files({"name": "m.map", "mimeType": "text/plain", "buffer": text.encode()})
    until(shown, "live.model.scene.axes[0].cells === 5")
    assert shown.evaluate(WALL) == 4
    shown.locator("#file").set_input_files({"name": "m.toml", "mimeType": "text/plain", "buffer": b"schema = 2"})
    until(shown, "!document.getElementById('toast').hidden")
    assert "m.toml" in shown.inner_text("#toast")


def test_dropped_images_and_ros_maps_are_opened(shown: Page):
    image, content = np.full((20, 30), 255, np.uint8), io.BytesIO()
    image[5:10, 5:10] = 0
    Image.fromarray(image).save(content, "PNG")
    pgm = b"P5 30 20 255\n" + image.tobytes()
    yaml = b"image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    for files in ({"m.png": content.getvalue()}, {"m.pgm": pgm}, {"m.yaml": yaml, "m.pgm": pgm}):
        shown.get_by_role("button", name="New").click()
        shown.locator("#saving").get_by_role("button", name="32 × 32").click()
        shown.evaluate(
            """(files) => {
                const data = new DataTransfer();
                for (const [name, bytes] of files) data.items.add(new File([Uint8Array.from(bytes)], name));
                window.dispatchEvent(new DragEvent("drop", { dataTransfer: data, cancelable: true }));
            }""",
            [[name, list(content)] for name, content in files.items()],
        )
        until(shown, "live.model.scene.axes[0].cells === 30")
        assert shown.evaluate(WALL) == 25


def test_every_save_button_downloads_its_file(shown: Page):
    for label, name in (
        ("Scene", "scene.toml"),
        ("Picture", "resgrid.png"),
        ("Drawing", "resgrid.svg"),
        ("Paths", "paths.csv"),
        ("SPICE", "deck.zip"),
    ):
        shown.get_by_role("button", name="Save").click()
        with shown.expect_download() as download:
            shown.locator("#saving").get_by_role("button", name=label).click()
        assert download.value.suggested_filename == name


def test_the_keyboard_draws_walls_and_moves_goals(shown: Page):
    shown.locator("#canvas").focus()
    shown.evaluate("live.view.cursor = [30, 30]")
    shown.keyboard.press("w")
    shown.locator("#brush").fill("1")
    shown.locator("#canvas").focus()
    for _ in range(3):
        shown.keyboard.press("ArrowUp")
        shown.keyboard.press(" ")
    assert shown.evaluate(WALL) == 3
    shown.evaluate("live.view.cursor = [72, 72]")
    shown.keyboard.press("Shift+ArrowLeft")
    shown.keyboard.press("Shift+ArrowDown")
    assert shown.evaluate("live.model.scene.goals") == [[71 * 96 + 71]]
    shown.keyboard.press("g")
    shown.keyboard.press("ArrowLeft")
    shown.keyboard.press("Enter")
    settle(shown)
    assert shown.evaluate("live.model.scene.goals.length") == 2


def test_a_tap_draws_a_wall_on_a_phone(served: LivePage, chromium: Browser):
    context = chromium.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(f"{served.url}?tour=0")
    settle(page)
    page.touchscreen.tap(*point_on(page, (50.5, 50.5)))
    assert page.evaluate(WALL) > 0
    widest = page.evaluate("document.documentElement.scrollWidth")
    assert widest <= 390
    context.close()


def test_the_cell_card_shows_index_current_and_converter_bits(shown: Page):
    shown.mouse.move(*point_on(shown, (50.5, 50.5)))
    until(shown, "!document.getElementById('card').hidden")
    card = shown.inner_text("#card")
    assert "50, 50" in card and "converter bits" in card and "A" in card


def test_the_cell_card_names_the_certified_path_through_the_cell(shown: Page):
    middle = lines(shown)[0][len(lines(shown)[0]) // 2]
    shown.mouse.move(*point_on(shown, tuple(np.floor(middle) + 0.5)))
    until(shown, "!document.getElementById('card').hidden")
    card = shown.inner_text("#card")
    assert "✓ path 1 passes here, certified to goal 0" in card and "✓ Kirchhoff" in card


def test_a_small_circuit_is_drawn_with_every_resistor(shown: Page):
    shown.get_by_role("button", name="New").click()
    shown.locator("#saving").get_by_role("button", name="10 × 10").click()
    until(shown, "live.model.scene.axes[0].cells === 10")
    settle(shown)
    # inner faces of 10 x 10, and contacts of the border with free cells; the goal is one cell inside
    resistors = shown.evaluate("live.view.frame.circuit.resistors")
    assert len(resistors) == 2 * 9 * 10 + 4 * 10
    shown.mouse.move(*point_on(shown, (5.0, 4.5)))
    until(shown, "document.getElementById('card').textContent.includes('resistor')")
    assert "10 kΩ" in shown.inner_text("#card")
    shown.get_by_role("button", name="Break").click()
    shown.mouse.click(*point_on(shown, (5.03, 4.5)))
    settle(shown)
    shown.mouse.move(*point_on(shown, (5.0, 4.5)))
    until(shown, "document.getElementById('card').textContent.includes('cell')")
    assert [0, 5, 4] not in [row[:3] for row in shown.evaluate("live.view.frame.circuit.resistors")]
    shown.locator("#show-circuit").uncheck()
    assert shown.evaluate("live.view.circuit") is None


def test_a_read_only_page_rejects_strokes(chromium: Browser):
    with rg.live(read_only=True, browser=False) as reading:
        context = chromium.new_context()
        page = context.new_page()
        page.goto(f"{reading.url}?tour=0")
        settle(page)
        first = kept(page)
        drag(page, [(40, 20), (40, 40)])
        assert kept(page) == first
        assert not page.locator("#tools").is_visible()
        context.close()


def test_workspace_obstacles_of_an_arm_are_dragged_by_mouse(shown: Page):
    open_example(shown, "chair")
    until(shown, "live.model.scene.world !== null && live.world.poses.length > 1")
    settle(shown)
    walls, first = shown.evaluate(WALL), kept(shown)
    box = shown.locator("#world").bounding_box()
    assert box is not None
    metre, *place = shown.evaluate(
        "[live.world.matrix.a, ...live.world.toPixels([0.95, 0])].map((p) => p / live.world.ratio)"
    )
    x, y = box["x"] + place[0], box["y"] + place[1]
    shown.mouse.move(x, y)
    shown.mouse.down()
    shown.mouse.move(x, y + 0.7 * metre, steps=6)
    shown.mouse.up()
    until(shown, "live.model.before === null")
    settle(shown)
    lower = shown.evaluate("live.model.scene.world.obstacle[0].lower")
    assert lower == pytest.approx([0.7, -0.73], abs=0.03)
    assert shown.evaluate(WALL) != walls
    tip = shown.evaluate("live.world.poses.at(-1).at(-1)")
    assert 0.82 - 0.1 <= tip[0] <= 1.0 + 0.1 and 0.11 - 0.1 <= tip[1] <= 0.25 + 0.1
    shown.get_by_role("button", name="Undo").click()
    settle(shown)
    assert kept(shown) == first


def test_late_cells_of_an_arm_do_not_change_a_newer_scene(shown: Page):
    open_example(shown, "chair")
    until(shown, "live.model.scene.world !== null && live.world.poses.length > 1")
    settle(shown)
    left, now = shown.evaluate(
        """async () => {
            const { wire, world, model } = live, ask = wire.ask.bind(wire), chair = model.scene;
            let answer = () => {};
            wire.ask = (head, scene) => head.type === "world" ? new Promise((done) => answer = done) : ask(head, scene);
            const asked = world.resample();
            const axes = chair.axes.map((axis) => ({ ...axis }));
            model.reset({ ...chair, axes, cells: new Uint8Array(chair.cells.length) });
            answer(await ask({ type: "world" }, chair));
            await asked;
            return [chair.cells.some((cell) => cell), model.scene.cells.some((cell) => cell)];
        }"""
    )
    assert (left, now) == (True, False)


def test_workspace_obstacles_of_an_arm_are_moved_by_keys(shown: Page):
    open_example(shown, "chair")
    until(shown, "live.model.scene.world !== null && live.world.poses.length > 1")
    settle(shown)
    lower = "live.model.scene.world.obstacle[0].lower[1]"
    before, past = shown.evaluate(lower), shown.evaluate("live.model.past.length")
    shown.locator("#world").focus()
    shown.keyboard.press(" ")  # from the goal to the first obstacle
    shown.keyboard.press("ArrowUp")
    until(shown, f"live.model.past.length === {past + 1} && live.model.before === null")
    settle(shown)
    assert shown.evaluate(lower) > before


def test_a_touch_drag_draws_a_stroke(served: LivePage, chromium: Browser):
    context = chromium.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(f"{served.url}?tour=0")
    settle(page)
    page.locator("#brush").fill("1")
    finger = context.new_cdp_session(page)
    for kind, cell in (("touchStart", 30), ("touchMove", 40), ("touchMove", 50), ("touchEnd", None)):
        points = [] if cell is None else [dict(zip("xy", point_on(page, (cell + 0.5, 20.5)), strict=True))]
        finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    until(page, "live.model.before === null")
    assert page.evaluate(WALL) == 21
    settle(page)
    context.close()


def test_a_link_with_a_broken_resistor_also_shows_the_ideal_path(shown: Page, served: LivePage, chromium: Browser):
    whole = lines(shown)[0]
    middle = np.floor(whole[len(whole) // 2]).astype(int).tolist()
    shown.evaluate(f"live.model.replace({{ broken: [[{middle[0] + 1}, {middle[1]}, 0]] }})")
    settle(shown)
    other = chromium.new_context().new_page()
    other.goto(link_of(shown).replace("/#", "/?tour=0#"))
    until(other, "live.view.others.length === 1 && live.view.others[0].name === 'ideal'")
    ideal = np.reshape(other.evaluate("Array.from(live.view.others[0].lines[0])"), (-1, 2))
    np.testing.assert_array_equal(ideal, whole)
    other.context.close()


def test_url_parameters_hide_panels_forbid_edits_and_set_the_theme(served: LivePage, chromium: Browser):
    context = chromium.new_context()
    page = context.new_page()
    page.goto(f"{served.url}?tour=0&panel=0&edit=0&theme=dark")
    settle(page)
    assert page.evaluate("document.getElementById('page').dataset.theme") == "dark"
    for part in ("header", "#panel", "#tools"):
        assert not page.locator(part).is_visible()
    first = kept(page)
    drag(page, [(40, 20), (40, 40)])
    page.keyboard.press("Control+z")
    assert kept(page) == first
    context.close()


def test_the_tour_is_shown_once_and_the_theme_survives_a_reload(served: LivePage, chromium: Browser):
    context = chromium.new_context(color_scheme="light")
    page = context.new_page()
    page.goto(served.url)
    until(page, "document.getElementById('tour').open")
    assert page.locator("#tour li").count() == 5
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Dark or light").click()
    assert page.evaluate("document.getElementById('page').dataset.theme") == "dark"
    page.reload()
    settle(page)
    assert not page.evaluate("document.getElementById('tour').open")
    assert page.evaluate("document.getElementById('page').dataset.theme") == "dark"
    context.close()


def test_colours_equal_those_of_resgrid_plot_and_goals_are_yellow(shown: Page):
    colours = "import('/static/colours.js').then(({ colours }) => [Array.from(colours.ramp), colours.goal])"
    ramp, goal = shown.evaluate(colours)
    values = np.array(ramp, dtype=np.uint32)
    shades = np.stack([values & 255, values >> 8 & 255, values >> 16 & 255], axis=1) / 255.0
    np.testing.assert_allclose(shades, height_map()(np.linspace(0.0, 1.0, 1024))[:, :3], atol=0.012)
    assert goal == GOAL
    drop = "live.view.frame.picture[72 * 96 + 71]"  # a neighbour of the goal has the top of the scale
    assert shown.evaluate(drop) > 0.9 * 65534


def test_the_keyboard_breaks_resistors_and_adds_starts(shown: Page):
    for _ in range(40):
        if shown.evaluate("document.activeElement.id") == "canvas":
            break
        shown.keyboard.press("Tab")
    assert shown.evaluate("document.activeElement.id") == "canvas"
    shown.keyboard.press("x")
    shown.keyboard.press("ArrowRight")
    shown.keyboard.press("Enter")
    assert shown.evaluate("live.model.scene.broken") == [[50, 48, 0]]
    for key in ("s", "ArrowUp", " "):
        shown.keyboard.press(key)
    assert shown.evaluate("live.model.scene.starts.length") == 2
    settle(shown)


def test_a_stopped_server_is_reported_and_the_page_reconnects(chromium: Browser):
    before = rg.live(browser=False)
    context = chromium.new_context()
    page = context.new_page()
    page.goto(f"{before.url}?tour=0")
    settle(page)
    before.close()
    until(page, "document.getElementById('quality').dataset.state === 'error'")
    drag(page, [(40, 20), (40, 40)])
    drawn = kept(page)
    with rg.live(port=int(before.url.rsplit(":", 1)[1].strip("/")), browser=False):
        settle(page)
        assert kept(page) == drawn
        assert "✓ certified" in page.inner_text("#quality")
    context.close()
