"""Draw the pictures of the README and of the guide: ``python docs/pictures.py [NAME ...]``, all by default.

The pictures are part of the repository, because the README is read before anything is built.
"""

# ruff: noqa: TID251

import io
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.contour import ContourSet
from matplotlib.patches import Circle
from matplotlib.patheffects import Normal, Stroke
from PIL import Image

import resgrid as rg
from resgrid.live_page.drawing import drawing_of
from resgrid.live_page.frames import picture_of
from resgrid.live_page.settle import settle
from resgrid.live_page.solving import solve_drawing
from resgrid.plot.figures import new_figure, render_figure

DOCS = Path(__file__).resolve().parent
SCENES = DOCS.parent / "examples" / "scenes"
BLENDS = (0.0, 0.99, 1.0)
MOTION, HELD = 54, 16
"""Number of frames with moving robots, and number of frames that repeat the last one."""


def draw_rooms():
    """Draw potential, paths and currents of the rooms."""
    planner = rg.plan(rg.read_scene(SCENES / "rooms.toml"), k=1.0)
    rg.plot.save_figure(rg.plot.draw_summary(planner.field, planner.paths(), title="Rooms"), DOCS / "rooms.png")


def draw_blend():
    """Draw the same scene at three k, with the clearance of every path among other streamlines."""
    scene = rg.read_scene(SCENES / "rooms.toml")
    planner = rg.plan(scene, k=1.0)
    cells = np.argwhere(planner.space.goal_connected)
    others = planner.space.centre(cells[(cells % 9 == 4).all(axis=1)])
    figure = new_figure(10.2, 3.35)
    panels = figure.subplots(1, len(BLENDS), sharey=True)
    for k, axes in zip(BLENDS, panels, strict=True):
        plan = planner.at(k)
        paths = plan.paths()
        rg.draw(plan.space, axes)
        flow = [path.points for path in plan.paths(others)]
        axes.add_collection(LineCollection(flow, colors="#9db8cc", linewidths=0.4, zorder=1), autolim=False)
        axes.plot([], [], color="#9db8cc", linewidth=1, label="other streamlines")
        rg.draw(paths, axes)
        for path, shift in zip(paths, (9, 9, -16), strict=True):
            rg.certify(path)
            axes.annotate(
                f"{path.clearance:.2f} m", path.points[0], (0, shift), textcoords="offset points", ha="center",
                fontsize=7.5, zorder=9, bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"},
            )  # fmt: skip
        kind = {0.0: "obstacles open (Neumann)", 1.0: "obstacles on their rail (Dirichlet)"}.get(k, "a blend of both")
        closest = min(path.clearance for path in paths)
        axes.set_title(f"k = {k:g}: {kind}\nsmallest clearance {closest:.2f} m", fontsize=9)
        handles, labels = axes.get_legend_handles_labels()
        axes.get_legend().remove()
        axes.set_ylabel("y (m)" if axes is panels[0] else "")
    shown = dict(zip(labels, handles, strict=True))
    del shown["free"]  # the page's own colour; without it the legend fits in one row
    figure.legend(
        list(shown.values()), [*[*shown][:-2], "start, with the clearance of its path", "goal reached"],
        loc="outside lower center", ncols=6, fontsize=8, frameon=False,
    )  # fmt: skip
    rg.plot.save_figure(figure, DOCS / "blend_k.png")


def draw_motion():
    """Show how the grid settles, and how three robots then follow its current."""
    scene = rg.read_scene(SCENES / "rooms.toml")
    planner = rg.plan(scene, k=1.0)
    paths = planner.paths()
    figure = new_figure(5.4, 3.85)
    axes = rg.draw(planner.field, figure.add_subplot())
    axes.get_legend().remove()
    image, lines = axes.images[0], next(c for c in axes.collections if isinstance(c, ContourSet))
    for path in paths:
        rg.certify(path)
    disc = {"radius": scene.robot.radius, "facecolor": "white", "edgecolor": "black", "zorder": 7}
    robots = [axes.add_patch(Circle(path.points[0], **disc)) for path in paths]
    casing = [Stroke(linewidth=3.6, foreground="black"), Normal()]
    trails = [axes.plot([], [], color="white", linewidth=2.0, path_effects=casing, zorder=6)[0] for _ in paths]
    frames, steady = [], image.get_array()

    def keep(title, count=1):
        axes.set_title(title, fontsize=10)
        content = io.BytesIO(render_figure(figure, "png", dpi=120))
        frames.extend([Image.open(content).convert("RGB")] * count)

    lines.set_visible(False)
    for seconds, values in moments_of(scene, image.get_clim()):
        image.set_data(np.ma.masked_array(values.T, steady.mask))
        keep(f"{1e6 * seconds:.3g} µs after the rails were switched on")
    image.set_data(steady)
    lines.set_visible(True)
    keep("settled: every direction leads on to a goal", HELD)
    along = [np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path.points, axis=0), axis=1))) for path in paths]
    longest = max(part[-1] for part in along)
    for metres in np.linspace(0.0, longest, MOTION):
        for path, part, robot, trail in zip(paths, along, robots, trails, strict=True):
            done = np.append(part[part < metres], min(metres, part[-1]))
            places = np.stack([np.interp(done, part, column) for column in path.points.T])
            robot.set_center(places[:, -1])
            trail.set_data(*places)
        keep("robots follow the current; clearance " + ", ".join(f"{path.clearance:.2f}" for path in paths) + " m")
    frames += [frames[-1]] * HELD
    first, *rest = frames
    first.save(DOCS / "motion.webp", save_all=True, append_images=rest, duration=90, loop=0, quality=60, method=6)


def moments_of(scene, limits):
    """Yield times in seconds, and the decimal logarithm of the drop in every cell, while a scene's chip settles."""
    pages, (pictures, _) = settle(drawing_of(scene), None)
    drawing = drawing_of(scene)
    scale, _ = picture_of(solve_drawing(drawing, exact=True))
    values = np.frombuffer(pictures, "<u2").reshape(len(pages["times"]), *drawing.cell.shape) / 65534.0
    for seconds, value in zip(pages["times"], values, strict=True):
        yield seconds, np.clip(scale["low"] + value * (scale["high"] - scale["low"]), *limits)


PAGES = {
    "rooms": ("rooms", (50.5, 60.5), ""),
    "circuit": ("lesson", (3.0, 5.5), ""),
    "arm": ("chair", None, ""),
    "lattice": ("lesson", (5.5, 5.33), ""),
    "settling": ("rooms", (50.5, 60.5), "16"),
}
"""Pictures of the live page: the scene, the pointer position in cells, and a moment of the film."""


def draw_pages():
    """Save screenshots of the live page; this needs playwright and Chromium."""
    from playwright.sync_api import sync_playwright

    options = {"executable_path": "/usr/bin/chromium"} if Path("/usr/bin/chromium").exists() else {}
    solved = "live.model.scene && live.solved === live.model.scene && live.frames.at(-1).exact"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(args=["--no-sandbox", "--disable-gpu"], **options)
        for name, (scene, place, moment) in PAGES.items():
            with rg.live(rg.read_scene(SCENES / f"{scene}.toml"), browser=False) as served:
                page = browser.new_page(viewport={"width": 1280, "height": 720})
                page.goto(f"{served.url}?tour=0&theme=light")
                wait_for(page, solved)
                if name == "rooms":
                    page.locator("#k").fill("600")
                    page.locator("#show-ends").check()
                    wait_for(page, f"{solved} && live.view.others.length === 2")
                if name == "lattice":
                    page.select_option("#lattice", "hexagonal")
                    wait_for(page, solved)
                if moment:
                    page.get_by_role("button", name="Show transient").click()
                    wait_for(page, "document.getElementById('time').textContent.endsWith('settled')")
                    page.locator("#moment").fill(moment)
                    page.wait_for_timeout(300)
                if place:
                    script = "([i, j]) => live.view.toPixels([i, j]).map((pixel) => pixel / live.view.ratio)"
                    page.locator("#canvas").hover(position=dict(zip("xy", page.evaluate(script, place), strict=True)))
                    wait_for(page, "!document.getElementById('card').hidden")
                page.wait_for_timeout(1500)  # the dots spread
                content = io.BytesIO(page.screenshot())
                Image.open(content).convert("RGB").save(DOCS / f"live_{name}.webp", quality=80, method=6)
                page.close()
        browser.close()


def wait_for(page, condition, seconds=60.0):
    """Wait until a condition holds on a page."""
    end = time.monotonic() + seconds
    while not page.evaluate(f"Boolean({condition})"):
        if time.monotonic() > end:
            raise TimeoutError(condition)
        time.sleep(0.05)


def main():
    """Draw the named pictures, or all."""
    drawings = {"rooms": draw_rooms, "blend": draw_blend, "motion": draw_motion, "pages": draw_pages}
    for name in sys.argv[1:] or drawings:
        drawings[name]()


if __name__ == "__main__":
    main()
