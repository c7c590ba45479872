"""Keep-out and speed masks, compared with the formulas of Nav2's costmap filters and with shapely.

Tests internals: `resgrid.live_page.opening`, `resgrid.scene.maps.mask_grids`, `resgrid.scene.reading`,
`resgrid.scene.speed_zones`.
"""

import json
import zlib
from base64 import urlsafe_b64encode
from math import cos, sin

import numpy as np
import pytest
import shapely
from PIL import Image
from support.cli import call

import resgrid as rg
from resgrid.live_page.opening import open_document
from resgrid.scene.maps.mask_grids import read_mask
from resgrid.scene.reading import read_link
from resgrid.scene.speed_zones import speed_zones

FREE, WALL, UNKNOWN = 254, 0, 150


def write(folder, grey, name="map", origin=(0.0, 0.0, 0.0), resolution=0.1, **keys):
    Image.fromarray(np.asarray(grey, dtype=np.uint8)).save(folder / f"{name}.pgm")
    table = {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.25} | keys
    head = f"image: {name}.pgm\nresolution: {resolution}\norigin: {list(origin)}\n"
    (folder / f"{name}.yaml").write_text(head + "".join(f"{key}: {value}\n" for key, value in table.items()))
    return folder / f"{name}.yaml"


def write_raw(folder, occupancy, name="mask", **keys):
    """Write a mask whose pixels are occupancies, or 255 for unknown; the first row is the bottom row."""
    return write(folder, np.asarray(occupancy)[::-1], name, mode="raw", **keys)


def pixel_boxes(origin, resolution, shape):
    """Return the polygons (rows, columns) of the pixels of a map, from its header."""
    x, y, yaw = origin
    turn = np.array([[cos(yaw), -sin(yaw)], [sin(yaw), cos(yaw)]])
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    return np.array([
        [shapely.Polygon((np.add(corners, (i, j))) * resolution @ turn.T + (x, y)) for i in range(shape[1])]
        for j in range(shape[0])
    ])  # fmt: skip


PLACES = [
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.1),
    ((0.0, 0.0, 0.0), (0.33, 0.21, 0.0), 0.17),
    ((0.0, 0.0, 0.0), (0.4, -0.1, 0.6), 0.05),
    ((1.0, -2.0, 0.4), (0.7, -1.2, -1.1), 0.23),
    ((1.0, -2.0, 0.4), (0.6, -1.7, 0.4), 0.04),
]


@pytest.mark.parametrize(("map_at", "mask_at", "resolution"), PLACES)
def test_cells_that_overlap_a_lethal_pixel_are_forbidden(tmp_path, map_at, mask_at, resolution):
    """The reference intersects the polygons of all cells and pixels."""
    rng = np.random.default_rng(4)
    file = write(tmp_path, np.full((9, 11), FREE), origin=map_at)
    shape = (round(0.8 / resolution), round(0.9 / resolution))
    occupancy = rng.choice([0, 40, 99, 100, 255], size=shape, p=[0.5, 0.1, 0.1, 0.15, 0.15])
    mask = rg.Mask(str(write_raw(tmp_path, occupancy, origin=mask_at, resolution=resolution)), "keepout")
    space = rg.build_space(rg.read_scene(file, mask=(mask,)), require_goal=False)
    cells, pixels = pixel_boxes(map_at, 0.1, (9, 11)), pixel_boxes(mask_at, resolution, shape)
    area = shapely.area(shapely.intersection(cells[:, :, None, None], pixels[None, None]))
    overlap = area > 1e-9
    known = np.where(occupancy == 255, -1, occupancy)
    largest = np.where(overlap, known, -1).max(axis=(2, 3))
    assert ((largest >= 100) == (space.cell == rg.Cell.OBSTACLE).T).all() and (largest >= 100).any()
    weight = np.where(largest >= 100, 0, np.clip(largest, 0, None)) / 100
    assert pytest.approx(0.1**weight) == space.conductivity.T


@pytest.mark.parametrize(("map_at", "mask_at", "resolution"), PLACES)
def test_centre_sampling_equals_the_loop_of_the_keepout_filter(tmp_path, map_at, mask_at, resolution):
    """KeepoutFilter::process: the mask's cost at the centre of each cell of the map; 100 becomes 254 (lethal)."""
    rng = np.random.default_rng(8)
    file = write(tmp_path, np.full((9, 11), FREE), origin=map_at)
    shape = (round(0.8 / resolution), round(0.9 / resolution))
    occupancy = rng.choice([0, 40, 99, 100, 255], size=shape)
    mask = rg.Mask(str(write_raw(tmp_path, occupancy, origin=mask_at, resolution=resolution)), "keepout")
    space = rg.build_space(rg.read_scene(file, mask=(mask,), sampling="centre"), require_goal=False)
    for i in range(11):
        for j in range(9):
            x, y, yaw = map_at
            u, v = (i + 0.5) * 0.1, (j + 0.5) * 0.1
            wx, wy = x + u * cos(yaw) - v * sin(yaw) - mask_at[0], y + u * sin(yaw) + v * cos(yaw) - mask_at[1]
            mx = (wx * cos(mask_at[2]) + wy * sin(mask_at[2])) / resolution
            my = (-wx * sin(mask_at[2]) + wy * cos(mask_at[2])) / resolution
            inside = 0 <= mx < shape[1] and 0 <= my < shape[0]
            data = int(occupancy[int(my), int(mx)]) if inside else 255
            cost = 255 if data == 255 else round(data * 254 / 100)
            assert (space.cell[i, j] == rg.Cell.OBSTACLE) == (cost == 254)


@pytest.mark.parametrize(("dialect", "forbidden"), [("nav2", 1), ("nav2-jazzy", 1), ("ros1", 5)])
def test_raw_pixels_above_100_are_forbidden_in_ros1_as_in_its_costmap(tmp_path, dialect, forbidden):
    file = write(tmp_path, np.full((1, 7), FREE))
    name = str(write_raw(tmp_path, [[99, 100, 101, 127, 128, 254, 255]]))
    scene = rg.read_scene(file, mask=(rg.Mask(name, "keepout", dialect=dialect),))
    cell = rg.build_space(scene, require_goal=False).cell[:, 0]
    assert cell.tolist() == [0, *([1] * forbidden), *([0] * (6 - forbidden))]


def test_keepout_areas_are_not_inflated_unless_asked(tmp_path):
    file = write(tmp_path, np.full((20, 30), FREE))
    occupancy = np.zeros((20, 30), int)
    occupancy[8:12, 14:16] = 100
    name = str(write_raw(tmp_path, occupancy))
    robot = rg.PointRobot(0.25)
    bare, grown = (
        rg.build_space(rg.read_scene(file, robot=robot, mask=(rg.Mask(name, "keepout", inflate=inflate),)),
                       require_goal=False).cell
        for inflate in (False, True)
    )  # fmt: skip
    assert (occupancy // 100 == bare.T).all()
    wall = np.where(occupancy[::-1] == 100, WALL, FREE)
    expected = rg.build_space(rg.read_scene(write(tmp_path, wall, "wall"), robot=robot), require_goal=False).cell
    assert (grown == expected).all() and grown.sum() > bare.sum()


def test_inflated_keepout_areas_are_columns_in_space(tmp_path):
    np.save(tmp_path / "voxels.npy", np.zeros((12, 10, 4), np.uint8))
    occupancy = np.zeros((10, 12), int)
    occupancy[3:5, 6:8] = 100
    name = str(write_raw(tmp_path, occupancy, resolution=1.0))
    robot = rg.PointRobot(1.5)
    space, plane = (
        rg.build_space(rg.read_scene(file, robot=robot, mask=(rg.Mask(name, "keepout", inflate=True),)),
                       require_goal=False).cell
        for file in (tmp_path / "voxels.npy", write(tmp_path, np.full((10, 12), FREE), resolution=1.0))
    )  # fmt: skip
    assert plane.any() and (space == plane[:, :, None]).all()


@pytest.mark.parametrize("sampling", ["conservative", "centre"])
@pytest.mark.parametrize(("crop", "origin"), [(None, (-0.3, 1.05, 0.2)), ((0.8, 0.8, 1.6, 1.9), (0.5, 0.2, 0.4))])
def test_inflated_keepout_pixels_around_the_grid_count(tmp_path, crop, origin, sampling):
    """The reference is the same mask on a larger map."""
    keys = {"robot": rg.PointRobot(0.25), "sampling": sampling}
    mask = write_raw(tmp_path, np.full((3, 3), 100), origin=origin, resolution=0.2)
    keys["mask"] = (rg.Mask(str(mask), "keepout", inflate=True),)
    large = write(tmp_path, np.full((60, 60), FREE), name="large", origin=(-2.0, -2.0, 0.0))
    small = write(tmp_path, np.full((25, 20), FREE), name="small")
    whole = rg.build_space(rg.read_scene(large, **keys), require_goal=False).cell
    part = rg.build_space(rg.read_scene(small, crop=crop, **keys), require_goal=False)
    assert (part.cell == rg.Cell.OBSTACLE).any()
    first = [round((axis.lower + 2) / 0.1) for axis in part.axes]
    assert (part.cell == whole[tuple(slice(a, a + n) for a, n in zip(first, part.shape, strict=True))]).all()
    for x in (1.6, 40.0, -40.0):  # a mask away from the robot's reach costs no memory
        far = write_raw(tmp_path, np.full((3, 3), 100), origin=(x, x, 0.0), resolution=0.2)
        scene = rg.read_scene(small, **keys | {"mask": (rg.Mask(str(far), "keepout", inflate=True),)})
        assert (rg.build_space(scene, require_goal=False).cell.any()) == (x == 1.6)


def test_paths_avoid_keepout_areas_and_messages_name_the_mask(tmp_path):
    file = write(tmp_path, np.full((20, 30), FREE))
    occupancy = np.zeros((20, 30), int)
    occupancy[:15, 14:16] = 100
    write_raw(tmp_path, occupancy, "keepout")
    text = 'schema = 1\ngoal = [{ point = [2.5, 0.5] }]\nstarts = [[0.5, 0.5]]\n[map]\nfile = "map.yaml"\n'
    (tmp_path / "scene.toml").write_text(text + '[[mask]]\nfile = "keepout.yaml"\nkind = "keepout"\n')
    scene = rg.read_scene(tmp_path / "scene.toml")
    path = rg.plan(scene).paths()[0]
    rg.certify(path)
    assert path.points[:, 1].max() > 1.5 and rg.read_scene(file).mask == ()
    blocked = call("path", tmp_path / "scene.toml", "--goal", "1.5,0.5")
    assert blocked.exit_code == 2 and "lies in the keep-out area of mask[0]" in blocked.stderr
    started = call("path", tmp_path / "scene.toml", "--start", "1.5,0.5")
    assert started.exit_code == 1 and "lies in the keep-out area of mask[0]" in started.stdout


def test_turning_robots_keep_their_reference_point_out(tmp_path):
    file = write(tmp_path, np.full((12, 12), FREE))
    occupancy = np.zeros((12, 12), int)
    occupancy[5:7, 5:7] = 100
    write_raw(tmp_path, occupancy)
    head = "schema = 1\nrobot.footprint = [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]\n[map]\nheadings = 8\n"
    text = head + 'file = "map.yaml"\n[[mask]]\nfile = "mask.yaml"\nkind = "keepout"\n'
    cell = rg.build_space(rg.parse_scene(text, folder=file.parent), require_goal=False).cell
    assert (cell.transpose(1, 0, 2) == (occupancy // 100)[..., None]).all() and cell.shape == (12, 12, 8)


def test_unknown_space_can_block_without_inflation(tmp_path):
    rng = np.random.default_rng(2)
    grey = rng.choice([FREE, WALL, UNKNOWN], size=(25, 25), p=[0.96, 0.02, 0.02])
    file, robot = write(tmp_path, grey), rg.PointRobot(0.23)
    only_walls = write(tmp_path, np.where(grey == UNKNOWN, FREE, grey), "walls")
    walls = rg.build_space(rg.read_scene(only_walls, robot=robot), require_goal=False).cell == rg.Cell.OBSTACLE
    expected = walls | (grey[::-1].T == UNKNOWN)
    for keys in ({}, {"crop": (0.55, 0.35, 1.6, 1.9)}):
        scene = rg.read_scene(file, inflate_around_unknown=False, **keys)
        table = 'schema = 1\nrobot = { type = "disc", radius = 0.23 }\n[map]\nfile = "map.yaml"\n'
        rest = "inflate_around_unknown = false\n" + (f"crop = {list(keys['crop'])}\n" if keys else "")
        scene = rg.parse_scene(table + rest, folder=tmp_path)
        found = rg.build_space(scene, require_goal=False).cell == rg.Cell.OBSTACLE
        at = (slice(5, 16), slice(3, 19)) if keys else (slice(None), slice(None))
        assert (found == expected[at]).all() and not found.all()
    inflated = rg.build_space(rg.read_scene(file, robot=robot), require_goal=False).cell
    assert inflated.sum() > expected.sum()


def limit_of(data, unit, base, multiplier):
    """SpeedFilter::getSpeedLimitAtPose: the limit of mask data, None for none."""
    if data in (0, 255):
        return None
    limit = data * multiplier + base
    if (unit == "percent" and not 0 <= limit <= 100) or limit < 0 or limit == 0:
        return None
    return limit


@pytest.mark.filterwarnings("ignore:.*out of range")
@pytest.mark.parametrize(("unit", "base", "multiplier"), [
    ("percent", 0.0, 1.0), ("percent", 100.0, -1.0), ("percent", 50.0, 1.0), ("m/s", 0.0, 0.01), ("m/s", 0.4, -0.01),
])  # fmt: skip
def test_speed_limits_equal_the_speed_filter(tmp_path, unit, base, multiplier):
    rng = np.random.default_rng(6)
    origin, resolution = (0.2, -0.1, 0.7), 0.13
    occupancy = rng.choice([0, 1, 30, 50, 77, 100, 255], size=(12, 15))
    mask = rg.Mask(str(write_raw(tmp_path, occupancy, origin=origin, resolution=resolution)), "speed", unit=unit,
                   base=base, multiplier=multiplier)  # fmt: skip
    points = rng.uniform(-2, 3, (400, 2))
    found = speed_zones([mask]).at(points)
    for number, (x, y) in enumerate(points):
        wx, wy = x - origin[0], y - origin[1]
        mx = (wx * cos(0.7) + wy * sin(0.7)) / resolution
        my = (-wx * sin(0.7) + wy * cos(0.7)) / resolution
        inside = 0 <= mx < 15 and 0 <= my < 12
        limit = limit_of(int(occupancy[int(my), int(mx)]), unit, base, multiplier) if inside else None
        expected = (1.0, np.inf) if limit is None else (limit / 100, np.inf) if unit == "percent" else (1.0, limit)
        assert (found.fraction[number], found.speed[number]) == pytest.approx(expected)


def speed_scene(folder, unit="percent", **keys):
    file = write(folder, np.full((20, 60), FREE))
    occupancy = np.zeros((20, 60), int)
    occupancy[:, 20:35] = 40
    occupancy[:, 35:40] = 80
    mask = rg.Mask(str(write_raw(folder, occupancy)), "speed", unit=unit, **keys)
    return rg.read_scene(file, goal=(5.5, 1.0), start=(0.5, 1.0), mask=(mask,))


def test_constant_speeds_change_at_the_borders_of_zones(tmp_path):
    scene = speed_scene(tmp_path)
    line = rg.Polyline(np.array([(0.5, 1.0), (5.5, 1.0)]), rg.build_space(scene))
    motion = rg.time_parameterize(line, velocity_limits=2.0, masks=scene.mask)
    assert motion.duration == pytest.approx(1.5 / 2 + 1.5 / 0.8 + 0.5 / 1.6 + 1.5 / 2)
    scene = speed_scene(tmp_path, unit="m/s", multiplier=0.01)
    motion = rg.time_parameterize(line, velocity_limits=2.0, masks=scene.mask)
    assert motion.duration == pytest.approx(1.5 / 2 + 1.5 / 0.4 + 0.5 / 0.8 + 1.5 / 2)
    assert rg.time_parameterize(line, velocity_limits=2.0).duration == pytest.approx(2.5)


@pytest.mark.parametrize("unit", ["percent", "m/s"])
def test_timed_paths_never_exceed_the_limit_of_their_place(tmp_path, unit):
    rng = np.random.default_rng(3)
    grey = np.full((30, 30), FREE)
    grey[8:10, :20] = grey[18:20, 10:] = WALL
    file = write(tmp_path, grey, origin=(0.0, 0.0, 0.2))
    occupancy = rng.choice([0, 15, 60, 100], size=(9, 9), p=[0.4, 0.2, 0.2, 0.2])
    mask = rg.Mask(str(write_raw(tmp_path, occupancy, origin=(-0.4, 0.1, -0.3), resolution=0.4)), "speed", unit=unit,
                   multiplier=1.0 if unit == "percent" else 0.01)  # fmt: skip
    to_world = np.array([[cos(0.2), -sin(0.2)], [sin(0.2), cos(0.2)]])
    scene = rg.read_scene(file, goal=tuple(to_world @ (2.5, 2.7)), start=tuple(to_world @ (0.4, 0.5)), mask=(mask,))
    path = rg.plan(scene).paths()[0]
    zones = speed_zones([mask])
    for chosen in (path, rg.shortcut(path, clearance=0.02)):
        for acceleration in (None, 2.0):
            motion = rg.time_parameterize(
                chosen, velocity_limits=1.2, acceleration_limits=acceleration, masks=scene.mask
            )
            plain = rg.time_parameterize(chosen, velocity_limits=1.2, acceleration_limits=acceleration)
            positions, velocities = motion.at(np.linspace(0, motion.duration, 20_001)[1:-1])
            limits = zones.at(positions)
            speed = np.linalg.norm(velocities, axis=1)
            excess = speed - np.minimum(1.2 * limits.fraction, limits.speed)
            assert (excess > 1e-6).mean() < 1e-3 and motion.duration > plain.duration  # samples on a border: rounding
            if acceleration is not None:
                assert np.abs(np.diff(velocities, axis=0)).max() <= 2.0 * motion.duration / 20_000 * 1.01


def test_control_slows_down_in_zones(tmp_path):
    scene = speed_scene(tmp_path)
    run = rg.simulation(scene, speed=0.5, k=1.0).run()
    assert run.ending == "arrived"
    speed = np.linalg.norm(run.velocity, axis=1)
    limits = speed_zones(scene.mask).at(run.configuration)
    assert (speed <= 0.5 * limits.fraction * (1 + 1e-6)).all()
    assert speed[limits.fraction == 0.4].max() == pytest.approx(0.2)
    free = rg.simulation(scene.replace(mask=()), speed=0.5, k=1.0).run()
    assert run.time[-1] > free.time[-1] * 1.2
    controller = rg.control.make_controller(rg.plan(scene, k=1.0).field, speed=0.5, masks=scene.mask)
    assert np.linalg.norm(controller.command((2.5, 1.0))) == pytest.approx(0.2)


def test_the_command_line_times_paths_with_the_limits_of_the_scene(tmp_path):
    speed_scene(tmp_path)
    text = 'schema = 1\ngoal = [{ point = [5.5, 1.0] }]\nstarts = [[0.5, 1.0]]\n[map]\nfile = "map.yaml"\n'
    zone = '[[mask]]\nfile = "mask.yaml"\nkind = "speed"\nunit = "m/s"\nmultiplier = 0.01\n'
    durations = []
    for name, content in (("plain", text), ("slow", text + zone)):
        (tmp_path / f"{name}.toml").write_text(content)
        done = call("path", tmp_path / f"{name}.toml", "--speed", "2", "--json", "-o", tmp_path / f"{name}.csv")
        assert done.exit_code == 0, done.stderr
        table = np.genfromtxt(tmp_path / f"{name}.csv", delimiter=",", names=True)
        durations.append(table[next(key for key in table.dtype.names if key in ("t", "time", "time_s"))].max())
    assert durations[1] > durations[0] + 3


@pytest.mark.parametrize(("keys", "message"), [
    ({"file": "absent.yaml", "kind": "keepout"}, r"absent\.yaml"),
    ({"file": "map.yaml", "kind": "speeds"}, "kind"),
    ({"file": "map.yaml", "kind": "speed", "lethal": 50}, "lethal belongs to masks of kind 'keepout'"),
    ({"file": "map.yaml", "kind": "keepout", "units": "m/s"}, "did you mean 'unit'"),
    ({"kind": "keepout"}, "file"),
])  # fmt: skip
def test_invalid_masks_are_rejected_with_one_message(tmp_path, keys, message):
    write(tmp_path, np.full((5, 5), FREE))
    table = "".join(f"{key} = {value!r}\n".replace("'", '"') for key, value in keys.items())
    text = f'schema = 1\n[map]\nfile = "map.yaml"\n[[mask]]\n{table}'
    with pytest.raises(rg.InputError, match=message):
        rg.build_space(rg.parse_scene(text, folder=tmp_path), require_goal=False)


def test_arms_do_not_accept_masks(tmp_path):
    arm = rg.Arm(lengths=(1.0, 1.0))
    name = str(write(tmp_path, np.full((5, 5), FREE)))
    with pytest.raises(rg.InputError, match="applies to robots that move in the plane"):
        rg.build_space(rg.Scene(arm.axes(8), robot=arm, mask=(rg.Mask(name, "keepout"),)), require_goal=False)


def test_out_of_range_limits_are_reported(tmp_path):
    name = str(write_raw(tmp_path, [[10, 90]]))
    with pytest.warns(UserWarning, match=r"1 pixels have a speed limit out of range, such as 180 percent"):
        speed_zones([rg.Mask(name, "speed", multiplier=2.0)])
    assert read_mask(name, "nav2").values.tolist() == [[10], [90]]


def test_links_and_scenes_on_the_live_page_cannot_name_masks():
    document = {"schema": 1, "mask": [{"file": "/etc/hosts", "kind": "keepout"}]}
    code = urlsafe_b64encode(zlib.compress(json.dumps(document).encode())).decode().rstrip("=")
    with pytest.raises(rg.InputError, match="needs the file of a map, mask or obstacle"):
        read_link(f"http://127.0.0.1/#s={code}")
    with pytest.raises(rg.InputError, match="needs the files of its masks"):
        open_document(document)


def test_a_mask_bounds_the_conductivity_of_cost_areas(tmp_path):
    file = write(tmp_path, np.full((10, 10), FREE))
    occupancy = np.zeros((10, 10), int)
    occupancy[:5] = 90
    mask = rg.Mask(str(write_raw(tmp_path, occupancy)), "keepout", least_conductivity=0.01)
    area = rg.CostArea(rg.HalfSpace((1.0, 0.0), 5.0), 0.8)
    plain, masked, both = (
        rg.build_space(rg.read_scene(file, **keys), require_goal=False).conductivity
        for keys in ({"areas": (area,)}, {"mask": (mask,)}, {"areas": (area,), "mask": (mask,)})
    )
    np.testing.assert_array_equal(both, np.minimum(plain, masked))
    assert (both < plain).any() and (both < masked).any()
