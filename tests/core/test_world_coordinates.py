"""What a person gives or gets lies in the world: a map that is turned gives the same motion, turned with it."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import ArrayLike, NDArray
from support.cli import call

import resgrid as rg

ROOM = """
..............
..............
..##......##..
..##......##..
......##......
......##......
..##......###.
..##......#.#.
..........#.#.
..........###.
"""
"""An enclosed cell at the lower right; the left column of text is x = 0, the last line y = 0."""

START, GOAL, ENCLOSED = (0.7, 4.1), (6.8, 0.2), (5.8, 0.7)


@dataclass(frozen=True)
class World:
    """A map file, and where its axes lie."""

    file: Path
    x: float
    y: float
    yaw: float

    def place(self, points: ArrayLike) -> NDArray[np.float64]:
        """World coordinates of points along the map's axes, shape (..., 2)."""
        return np.asarray(self.turn(points) + np.array([self.x, self.y]))

    def turn(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """World components of vectors along the map's axes."""
        x, y = np.moveaxis(np.asarray(vectors, dtype=float), -1, 0)
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.stack([c * x - s * y, s * x + c * y], axis=-1)

    def scene(self, **changes: object) -> rg.Scene:
        """The map with a start and a goal of the world."""
        changes = {"goals": (rg.GoalPoint(self.at(GOAL)),), "starts": (self.at(START),)} | changes
        return rg.read_scene(self.file).replace(**changes)

    def at(self, point: ArrayLike) -> tuple[float, ...]:
        """One point of the map in the world."""
        return tuple(self.place(point).tolist())

    def say(self, point: ArrayLike) -> str:
        """The same for the command line."""
        return ",".join(map(repr, self.at(point)))


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> tuple[World, World]:
    """One map as it is, and turned by 0.7 rad and moved."""
    folder = tmp_path_factory.mktemp("maps")
    rows = ROOM.split()
    pixels = "\n".join(" ".join("0" if mark == "#" else "254" for mark in row) for row in rows)
    (folder / "room.pgm").write_text(f"P2\n{len(rows[0])} {len(rows)}\n255\n{pixels}\n")
    made = []
    for name, place in (("plain", (0.0, 0.0, 0.0)), ("turned", (30.0, -20.0, 0.7))):
        header = {"image": "room.pgm", "resolution": 0.5, "origin": list(place)}
        header |= {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.25}
        file = folder / f"{name}.yaml"
        file.write_text(yaml.safe_dump(header))
        made.append(World(file, *place))
    return made[0], made[1]


def same(turned: ArrayLike, expected: ArrayLike, within: float = 1e-9) -> None:
    np.testing.assert_allclose(turned, expected, rtol=0, atol=within)


def test_the_ten_lines_follow_the_map(worlds: tuple[World, World]) -> None:
    def ten_lines(world: World) -> rg.Streamline:
        space = rg.build_space(world.scene())
        netlist = rg.compile_space(space, boundary="dirichlet", resistance=10e3)
        field = rg.field(rg.solve(netlist))
        path = rg.streamline(field, start=world.at(START))
        rg.certify(path)
        assert tuple(space.locate(path.points[0])) == tuple(path.cells[0])
        same(path.points[0], world.at(START))
        same(rg.streamlines(field, [world.at(START)]).length, [path.length])
        return path

    plain, turned = map(ten_lines, worlds)
    assert plain.outcome == turned.outcome == "reached"
    np.testing.assert_array_equal(turned.cells, plain.cells)
    same(turned.points, worlds[1].place(plain.points))
    np.testing.assert_array_equal(plain.points, plain.axis_points)


def test_the_readme_the_planner_and_the_command_line_give_one_path(worlds: tuple[World, World]) -> None:
    """The README's ten lines on a map, turned or not, with nothing changed but the file, the goal and the start."""
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    code = readme[readme.index("import resgrid as rg") :].partition("```")[0]
    for world in worlds:
        lines = code.replace('"examples/scenes/lesson.toml"', f"{str(world.file)!r}, goal={world.at(GOAL)}")
        names: dict[str, object] = {"print": lambda *_: None}
        exec(lines.replace("(0.5, 6.5)", repr(world.at(START))), names)
        own = names["path"]
        assert isinstance(own, rg.Streamline)
        answer = call("path", world.file, "--goal", world.say(GOAL), f"--start={world.say(START)}", "--json")
        (told,) = json.loads(answer.stdout)["paths"]
        planned = rg.plan(rg.read_scene(world.file, goal=world.at(GOAL))).path(world.at(START))
        assert own.outcome == told["outcome"] == planned.outcome == "reached"
        same(told["points"], own.points)
        same(planned.points, own.points)


def test_a_planner_answers_in_the_world(worlds: tuple[World, World]) -> None:
    plain, turned = (rg.plan(world.scene(), k=0.9) for world in worlds)
    same(turned.scene_starts, worlds[1].place(plain.scene_starts))
    starts = np.array([(0.2, 0.3), (3.3, 4.9), (2.6, 2.6)])
    for found, expected in zip(turned.paths(worlds[1].place(starts)), plain.paths(starts), strict=True):
        same(found.points, worlds[1].place(expected.points))
    same(turned.paths()[0].points, worlds[1].place(plain.paths()[0].points))
    same(turned.ends(worlds[1].place(starts)).length, plain.ends(starts).length)
    for planner, world in ((plain, worlds[0]), (turned, worlds[1])):
        verdict = rg.find_blocking_obstacles(planner.space, world.at(ENCLOSED))
        assert planner.path(world.at(ENCLOSED)).outcome == verdict.outcome == "no_path"
        same(planner.path(cell=(1, 8)).points[0], world.at((0.75, 4.25)))
    curves = [rg.planning.clearance_curve(planner, (0.0, 1.0)) for planner in (plain, turned)]
    same(curves[1].starts, worlds[1].place(curves[0].starts))
    same(curves[1].clearance, curves[0].clearance)


def test_obstacles_that_block_are_found_from_the_same_place(worlds: tuple[World, World]) -> None:
    for world in worlds:
        bar = [rg.Ball(world.at((5.75, 1.75)), 0.3), rg.Ball(world.at((0.2, 0.2)), 0.1)]
        verdict = rg.find_blocking_obstacles(world.scene(obstacles=bar), world.at(ENCLOSED))
        assert (verdict.outcome, verdict.separating) == ("no_path", ("map",))
        assert rg.find_blocking_obstacles(world.scene(obstacles=bar), world.at(START)).outcome == "reached"


def test_what_is_made_of_a_path_stays_in_the_world(worlds: tuple[World, World]) -> None:
    made = []
    for world in worlds:
        planner = rg.plan(world.scene())
        path = planner.path(world.at(START))
        short = rg.shortcut(path, clearance=0.05)
        for way in (path, short, rg.Polyline(path.points, path.space), rg.Polyline(short.points, path.space)):
            rg.certify_collision_free(way)
            same(rg.planning.unwrap(way)[-1], path.points[-1])
        grid = path.space
        wide = rg.ConfigurationSpace(grid.axes, grid.cell, frame=grid.frame, robot=rg.PointRobot(0.05))
        far, near = rg.Ball(world.at((0.6, 0.7)), 0.3), rg.Ball(tuple(short.points[1].tolist()), 0.2)
        assert rg.check_collisions(short, [far]) is None
        for way, apart in ((short, 0.2), (rg.Polyline(short.points, wide), 0.25)):
            hit = rg.check_collisions(way, [far, near], step=1e-3)
            assert hit is not None
            assert hit.obstacle == 1
            same(np.linalg.norm(hit.configuration - near.centre), apart, 2e-3)
        motion = rg.time_parameterize(short, velocity_limits=0.5, acceleration_limits=0.25)
        made.append((short.points, motion.positions, motion.duration, rg.planning.workspace_path(short)))
        made[-1] += (rg.planning.workspace_clearance(short, [far]),)
    (points, positions, duration, way, clear), (t_points, t_positions, t_duration, t_way, t_clear) = made
    for turned, plain in ((t_points, points), (t_positions, positions), (t_way, way)):
        same(turned, worlds[1].place(plain))
    same((t_duration, t_clear), (duration, clear))


def test_written_rates_keep_the_limits_in_the_world(worlds: tuple[World, World]) -> None:
    for world in worlds:
        planner = rg.plan(world.scene())
        path = planner.path(world.at(START))
        motion = rg.time_parameterize(path, velocity_limits=(0.5, 0.25), acceleration_limits=(0.3, 0.2))
        _, _, velocities = motion.sample(50)
        assert np.all(np.abs(velocities) <= np.array((0.5, 0.25)) * (1 + 1e-9))
        assert np.abs(velocities).max(axis=0) == pytest.approx((0.5, 0.25), rel=0.2)


def test_files_hold_the_world(worlds: tuple[World, World], tmp_path: Path) -> None:
    read = []
    for number, world in enumerate(worlds):
        planner = rg.plan(world.scene())
        motion = rg.time_parameterize(planner.path(world.at(START)), velocity_limits=0.5)
        files = [rg.save(motion, tmp_path / f"{number}{end}") for end in (".csv", ".json", ".npz")]
        rows = list(csv.DictReader(files[0].read_text().splitlines()))
        names = [name for name in rows[0] if name not in ("path", "k", "outcome")]
        table = {name: np.array([float(row[name]) for row in rows]) for name in names}
        with np.load(files[2]) as arrays:
            for name, column in table.items():
                same(arrays[name], column)
                same(json.loads(files[1].read_text())[name], column)
        plan = yaml.safe_load(rg.save(motion, tmp_path / "plan.yaml").read_text())
        places = [(p["pose"]["position"]["x"], p["pose"]["position"]["y"]) for p in plan["poses"]]
        same(places, np.stack([table["x"], table["y"]], axis=1))
        read.append(table)
    plain, turned = read
    same(np.stack([turned["x"], turned["y"]], -1), worlds[1].place(np.stack([plain["x"], plain["y"]], -1)))
    rates = np.stack([plain["x_rate"], plain["y_rate"]], -1)
    same(np.stack([turned["x_rate"], turned["y_rate"]], -1), worlds[1].turn(rates))
    same(turned["t"], plain["t"])


def test_a_controller_is_asked_and_answers_in_the_world(worlds: tuple[World, World]) -> None:
    stiff = np.array([[0.8, 0.1], [0.1, 0.3]])
    for response in ("admittance", "equipotential"):
        answers = []
        for world in worlds:
            turn = world.turn(np.eye(2)).T
            controller = rg.control.make_controller(
                rg.plan(world.scene()).field, speed=0.4, admittance=turn @ stiff @ turn.T, speed_limits=9.0,
                response=response,
            )  # fmt: skip
            free = [controller.command(world.at(point)) for point in ((0.7, 4.1), (2.9, 0.4))]
            pushed = controller.command(world.at(START), world.turn((0.3, -0.2)))
            led_back = controller.command(world.at((1.05, 1.1)))
            same(controller.nominal(world.at(START)).velocity, free[0])
            answers.append([*free, pushed, led_back])
        same(answers[1], worlds[1].turn(answers[0]))


def test_speed_limits_of_a_controller_are_those_of_the_world(worlds: tuple[World, World]) -> None:
    for world in worlds:
        controller = rg.control.make_controller(rg.plan(world.scene()).field, speed=1.0, speed_limits=(0.3, 0.2))
        asked = np.array([controller.command(world.at(point)) for point in ((0.7, 4.1), (2.9, 0.4), (6.7, 4.0))])
        assert np.abs(asked / (0.3, 0.2)).max(axis=1) == pytest.approx([1, 1, 1])


def test_a_run_is_told_in_the_world(worlds: tuple[World, World]) -> None:
    runs = []
    for world in worlds:
        scene = world.scene(hidden=(rg.Ball(world.at((5.2, 2.3)), 0.3),))
        sim = rg.simulation(scene, speed=0.4)
        pushes = [rg.control.ExternalForce(1.0, 0.5, world.turn((0.3, -0.3)))]
        run = sim.run(world.at(START), pushes=pushes, bias=world.turn((0.02, 0.01)))
        same(run.configuration[0], world.at(START))
        assert np.all(sim.plant.penetration(run.configuration) == 0)
        felt: list[NDArray[np.float64]] = []

        def push(time: float, at: NDArray[np.float64], felt: list[NDArray[np.float64]] = felt) -> tuple[float, float]:
            felt.append(at)
            return (0.0, 0.0) if time else (0.1, 0.0)

        pushed = sim.run(world.at(START), pushes=push, max_steps=2)
        same(felt[0], world.at(START))
        same(pushed.push[0], (0.1, 0.0))
        runs.append(run)
    plain, turned = runs
    assert plain.ending == turned.ending == "arrived"
    assert len(plain.contacts.step)
    assert len(plain.lessons)
    place, turn = worlds[1].place, worlds[1].turn
    same(turned.time, plain.time, 1e-6)
    for name in ("configuration", "believed"):
        same(getattr(turned, name), place(getattr(plain, name)), 1e-6)
    for name in ("velocity", "torque", "push"):
        same(getattr(turned, name), turn(getattr(plain, name)), 1e-5)
    same(turned.contacts.point, place(plain.contacts.point), 1e-6)
    same(turned.contacts.normal, turn(plain.contacts.normal), 1e-5)
    for lesson, other in zip(turned.lessons, plain.lessons, strict=True):
        same(lesson.points, place(other.points), 1e-6)


def test_normals_are_those_of_the_world(worlds: tuple[World, World]) -> None:
    points = np.array([(1.6, 0.3), (3.9, 3.2)])
    plain, turned = (
        rg.planning.surface_normals(rg.build_space(world.scene()), world.place(points)) for world in worlds
    )  # fmt: skip
    same(turned, worlds[1].turn(plain))


def test_the_command_line_agrees_with_python(worlds: tuple[World, World], tmp_path: Path) -> None:
    told = []
    for world in worlds:
        words = [str(world.file), f"--goal={world.say(GOAL)}", f"--start={world.say(START)}"]
        result = call("path", *words, "--json")
        assert result.exit_code == 0, result.output
        (path,) = json.loads(result.stdout)["paths"]
        same(path["points"], rg.plan(world.scene()).path(world.at(START)).points)
        log = tmp_path / "log.csv"
        words += ["--speed", "0.4", f"--push=1,0.5,{','.join(map(repr, world.turn((0.3, -0.3)).tolist()))}"]
        result = call("control", *words, "-o", log, "--json")
        assert result.exit_code == 0, result.output
        run = json.loads(result.stdout)["runs"][0]
        rows = list(csv.DictReader(log.read_text().splitlines()))
        way = np.array([(float(row["x"]), float(row["y"])) for row in rows])
        pushes = np.array([(float(row["x_push"]), float(row["y_push"])) for row in rows])
        same(pushes[np.any(pushes != 0, axis=1)][0], world.turn((0.3, -0.3)))
        told.append((path["points"], way, run["end"]))
    for plain, turned in zip(*told, strict=True):
        same(turned, worlds[1].place(plain), 1e-6)


def test_a_goal_given_by_its_bounds_lies_in_the_world(worlds: tuple[World, World]) -> None:
    for world in worlds:
        lower = np.array(world.at((6.0, 3.5))) - 0.6
        upper = lower + 1.2
        space = rg.build_space(world.scene(goals=(rg.GoalJoints(tuple(lower.tolist()), tuple(upper.tolist())),)))
        goals = space.to_world(space.goal_points)
        assert len(goals) >= 2
        assert np.all((goals >= lower - 1e-9) & (goals <= upper + 1e-9))


def test_pictures_are_drawn_in_the_world(worlds: tuple[World, World]) -> None:
    for world in worlds:
        planner = rg.plan(world.scene())
        path = planner.path(world.at(START))
        axes = rg.draw(path)
        drawn = np.concatenate([line.vertices for line in axes.collections[0].get_paths()])
        same(drawn, path.points)
        corners = world.place([(0, 0), (7, 0), (7, 5), (0, 5)])
        same((axes.get_xlim(), axes.get_ylim()), np.stack([corners.min(axis=0), corners.max(axis=0)], axis=1))


def test_a_field_of_another_frame_is_refused(worlds: tuple[World, World]) -> None:
    plain = rg.plan(worlds[0].scene())
    with pytest.raises(rg.InputError, match="different spaces"):
        rg.blend(plain.field, rg.plan(worlds[1].scene(), boundary="neumann").field, 0.5)


def test_a_start_outside_a_turned_map_is_named_as_it_was_given(worlds: tuple[World, World]) -> None:
    with pytest.raises(rg.InputError, match=r"start \(1.0, 1.0\) lies outside the map; in the map's own axes"):
        rg.plan(worlds[1].scene()).paths([worlds[1].at(START), (1.0, 1.0)])


def test_only_a_plane_is_turned() -> None:
    axes = [rg.Axis(name, 0.0, 2.0, 2) for name in "xyz"]
    with pytest.raises(rg.InputError, match="only a plane"):
        rg.ConfigurationSpace(axes, np.zeros((2, 2, 2)), frame=rg.Frame(1.0, 0.0, 0.0))


@pytest.mark.parametrize("starts", [np.zeros((4, 3)), np.zeros(6), np.zeros((1, 1, 2)), 5.0, "here"])
def test_many_starts_are_rows_and_nothing_else(worlds: tuple[World, World], starts: object) -> None:
    planner = rg.plan(worlds[0].scene(), k=0.5)
    for ask in (
        lambda: rg.streamlines(planner.field, starts),
        lambda: planner.ends(starts),
        lambda: planner.paths(starts),
        lambda: rg.planning.clearance_curve(planner, (0.0,), starts),
        lambda: planner.path(starts),
    ):
        with pytest.raises(rg.InputError, match="start"):
            ask()
    assert len(rg.streamlines(planner.field, []).goal) == 0
