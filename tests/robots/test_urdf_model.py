"""Kinematic trees from URDF files, compared with pin's kinematics and geometry, and their pairs of bodies.

Tests internals: `resgrid.robots.urdf.model`, `resgrid.robots.urdf.description`.
"""

import pickle
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from resgrid.errors import InputError
from resgrid.robots.convex import Body, Solid
from resgrid.robots.convex_cover import body_of
from resgrid.robots.solids import rigid_pose
from resgrid.robots.urdf.description import read_description
from resgrid.robots.urdf.model import read_tree, with_obstacles

ROBOTS = Path(__file__).resolve().parents[2] / "examples" / "robots"
KINDS = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]
MOVING = {
    "scara": ["shoulder", "elbow", "quill"],
    "elbow": ["turn", "shoulder", "elbow"],
    "gantry": ["finger_left", "x", "turn"],
    "four": ["turn", "shoulder", "elbow", "wrist"],
}


@pytest.fixture(scope="module")
def pin():
    return import_module("pinocchio")


@pytest.fixture(scope="module")
def data(pin):
    """Folder of the robots in the package example-robot-data."""
    prefix = next(path for path in Path(pin.__file__).parents if path.name == "cmeel.prefix")
    folder = prefix / "share" / "example-robot-data" / "robots"
    if not folder.is_dir():
        pytest.skip("example-robot-data is not installed")
    return folder


def movable(description):
    """Names of the joints that can be asked to move."""
    return [
        name
        for name, joint in description.joints.items()
        if joint.kind in ("revolute", "continuous", "prismatic")
        and joint.mimic is None
        and (joint.kind == "continuous" or (joint.limits is not None and joint.limits[0] < joint.limits[1]))
    ]


def value_of(description, name, values):
    """The value of a joint by the definition of URDF, with given values of independent joints."""
    joint = description.joints[name]
    if joint.mimic is not None:
        driver, factor, offset = joint.mimic
        return factor * value_of(description, driver, values) + offset
    if name in values:
        return values[name]
    return float(np.clip(0.0, *joint.limits)) if joint.limits else 0.0


def pin_data(pin, model, description, values):
    """pin's kinematics at given joint values."""
    q = pin.neutral(model)
    for index in range(1, model.njoints):
        joint, value = model.joints[index], value_of(description, model.names[index], values)
        if joint.nq == 1:
            q[joint.idx_q] = value
        elif joint.nq == 2:
            q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
    kinematics = model.createData()
    pin.framesForwardKinematics(model, kinematics, q)
    return kinematics


def check_frames(pin, file, rng, count=3):
    """Compare the poses of all links with pin, for random moving joints, locked values, base and configurations."""
    description = read_description(file)
    names = movable(description)
    if not names:
        return False
    moving = [str(name) for name in rng.permutation(names)[: rng.integers(1, 5)]]
    base = rng.uniform(-1, 1, 6)
    at = {
        name: float(rng.uniform(*(description.joints[name].limits or (-3.0, 3.0))))
        for name in names
        if name not in moving and rng.random() < 0.7
    }
    tree = read_tree(file, moving, at, base=base.tolist(), pieces=1)
    assert (tree.parent < np.arange(len(tree.names))).all()
    model = pin.buildModelFromUrdf(str(file))
    for configuration in rng.uniform(tree.lower, tree.upper, (count, len(moving))):
        kinematics = pin_data(pin, model, description, at | dict(zip(moving, configuration, strict=True)))
        frames = tree.frames(configuration[np.newaxis])[0]
        for link, (joint, local) in tree.tools.items():
            mine = (frames[joint] if joint >= 0 else np.eye(4)) @ local
            theirs = kinematics.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous
            np.testing.assert_allclose(mine, rigid_pose(base[:3], base[3:]) @ theirs, atol=1e-9)
    return True


@pytest.mark.parametrize("name", MOVING)
def test_frames_of_own_robots_agree_with_pin(pin, name):
    rng = np.random.default_rng(1)
    for _ in range(5):
        assert check_frames(pin, ROBOTS / f"{name}.urdf", rng)


@pytest.mark.parametrize("seed", range(12))
def test_frames_of_random_robots_agree_with_pin(pin, tmp_path, seed):
    rng = np.random.default_rng(seed)
    lines = ['<robot name="random"><link name="l0"/>']
    joints: list[str] = []
    for number in range(1, 14):
        kind = rng.choice(KINDS, p=[0.3, 0.2, 0.2, 0.2, 0.05, 0.05])
        xyz, rpy, axis = (" ".join(map(repr, rng.normal(size=3).tolist())) for _ in range(3))
        lines.append(
            f'<link name="l{number}"/><joint name="j{number}" type="{kind}"><parent link="l{rng.integers(number)}"/>'
            f'<child link="l{number}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="3" effort="1" velocity="2"/>'
        )
        if kind in ("revolute", "continuous", "prismatic"):
            if joints and rng.random() < 0.4:  # also of a joint that is a mimic joint itself
                factor, offset = rng.normal(size=2).tolist()
                lines.append(f'<mimic joint="{rng.choice(joints)}" multiplier="{factor!r}" offset="{offset!r}"/>')
            joints.append(f"j{number}")
        lines.append("</joint>")
    file = tmp_path / "random.urdf"
    file.write_text("".join(lines) + "</robot>")
    for _ in range(4):
        assert check_frames(pin, file, rng)


@pytest.mark.slow
def test_frames_of_all_robots_of_example_robot_data_agree_with_pin(pin, data, tmp_path):
    rng = np.random.default_rng(2)
    unusable = {}
    checked = 0
    for file in sorted(data.rglob("*.urdf")):
        robot = ElementTree.parse(file).getroot()
        for link in robot.findall("link"):  # meshes take most of the time
            for tag in ("collision", "visual"):
                for each in link.findall(tag):
                    link.remove(each)
        bare = tmp_path / file.name
        ElementTree.ElementTree(robot).write(bare)
        try:
            checked += check_frames(pin, bare, rng, count=1)
        except InputError as error:
            unusable[file.stem] = str(error)
    assert checked > 60
    assert set(unusable) <= {"ur3", "alex_psyonic_hands"}  # no links; a mimic joint without its driver


@pytest.mark.parametrize(
    "path",
    ["ur_description/urdf/ur5_robot.urdf", "panda_description/urdf/panda.urdf", "baxter_description/urdf/baxter.urdf"],
)
def test_collision_geometries_agree_with_pin(pin, data, path):
    coal = import_module("coal")
    file = data / path
    description = read_description(file)
    moving = movable(description)[:3]
    tree = read_tree(file, moving, pieces=1)
    model = pin.buildModelFromUrdf(str(file))
    geometry = pin.buildGeomFromUrdf(model, str(file), pin.GeometryType.COLLISION, package_dirs=[str(data.parents[1])])
    configuration = np.random.default_rng(3).uniform(tree.lower, tree.upper)
    kinematics = pin_data(pin, model, description, dict(zip(moving, configuration, strict=True)))
    frames = tree.frames(configuration[np.newaxis])[0]
    theirs: dict[str, list] = {}
    for each in geometry.geometryObjects:
        theirs.setdefault(model.frames[each.parentFrame].name, []).append(each)
    mine: dict[str, list[Body]] = {}
    for body in tree.bodies:
        mine.setdefault(body.name.partition("[")[0], []).append(body)
    assert mine.keys() == theirs.keys()
    for link, bodies in mine.items():
        assert len(bodies) == len(theirs[link])
        for body, each in zip(bodies, theirs[link], strict=True):
            frame = frames[body.joint] if body.joint >= 0 else np.eye(4)
            expected = (kinematics.oMi[each.parentJoint] * each.placement).homogeneous
            if body.solid.kind == "mesh":
                scaled = np.array([np.array(point) for point in each.geometry.vertices()])
                points = body.solid.points
                np.testing.assert_allclose(points.min(axis=0), scaled.min(axis=0), atol=1e-6)
                np.testing.assert_allclose(points.max(axis=0), scaled.max(axis=0), atol=1e-6)
            elif body.solid.kind == "box":
                np.testing.assert_allclose(body.solid.size, 2 * np.array(each.geometry.halfSide))
            elif body.solid.kind == "cylinder":
                assert isinstance(each.geometry, coal.Cylinder)
                assert body.solid.size == pytest.approx((each.geometry.radius, 2 * each.geometry.halfLength))
            np.testing.assert_allclose(frame @ body.solid.placement, expected, atol=1e-9)


def test_a_tree_has_limits_speeds_and_periodic_joints_of_the_file():
    tree = read_tree(ROBOTS / "elbow.urdf", ["shoulder", "turn"])
    assert tree.moving == ("shoulder", "turn")
    np.testing.assert_allclose(tree.lower, [-1.9, -np.pi])
    np.testing.assert_allclose(tree.upper, [1.9, np.pi])
    np.testing.assert_allclose(tree.velocity, [2.0, 2.0])
    assert tree.is_continuous.tolist() == [False, True]
    again = pickle.loads(pickle.dumps(tree))
    np.testing.assert_array_equal(again.frames(np.zeros((1, 2))), tree.frames(np.zeros((1, 2))))


def test_mimic_joints_follow_a_moving_driver_and_are_locked_with_a_locked_one():
    tree = read_tree(ROBOTS / "gantry.urdf", ["x", "finger_left"])
    right = tree.names.index("finger_right")
    assert (tree.driver[right], tree.factor[right], tree.offset[right]) == (1, -1.0, 0.0)
    locked = read_tree(ROBOTS / "gantry.urdf", ["x"], {"finger_left": 0.03})
    assert locked.names == ("x",)
    left, right = (locked.tools[f"finger_{side}"][1][1, 3] for side in ("left", "right"))
    carriage = locked.tools["carriage"][1][1, 3]
    assert (left - carriage, right - carriage) == (pytest.approx(0.036), pytest.approx(-0.036))


def test_a_joint_without_a_value_is_locked_at_its_limit_closest_to_0(data):
    tree = read_tree(data / "panda_description" / "urdf" / "panda.urdf", ["panda_joint1"], pieces=1)
    explicit = read_tree(
        data / "panda_description" / "urdf" / "panda.urdf", ["panda_joint1"], {"panda_joint4": -0.0698}, pieces=1
    )
    np.testing.assert_array_equal(tree.tools["panda_hand"][1], explicit.tools["panda_hand"][1])


def names_of(tree):
    """Pairs of a tree as sets of link names."""
    return {frozenset(tree.bodies[index].name.partition("[")[0] for index in pair) for pair in tree.pairs}


def test_pairs_leave_out_adjacent_links_and_pairs_that_do_not_move_relative_to_each_other():
    tree = read_tree(ROBOTS / "four.urdf", ["turn", "shoulder", "elbow", "wrist"])
    expected = {
        ("base", "upper_arm"),
        ("base", "forearm"),
        ("base", "wrist"),
        ("turntable", "forearm"),
        ("turntable", "wrist"),
    }
    assert names_of(tree) == {*map(frozenset, expected), frozenset(("upper_arm", "wrist"))}
    assert (np.array([body.joint for body in tree.bodies])[tree.pairs[:, 0]] >= 0).all()
    locked = read_tree(ROBOTS / "four.urdf", ["elbow"])
    # The wrist is locked: it may still hit the upper arm, which only the elbow joins to it.
    assert names_of(locked) == {frozenset(pair) for pair in expected if "upper_arm" not in pair} | {
        frozenset(("upper_arm", "wrist"))
    }


def test_an_srdf_file_disables_pairs_and_can_enable_them_again(tmp_path):
    moving = MOVING["four"]
    file = tmp_path / "four.srdf"
    file.write_text('<robot name="four"><disable_collisions link1="base" link2="wrist"/></robot>')
    pairs = names_of(read_tree(ROBOTS / "four.urdf", moving, srdf=file))
    assert frozenset(("base", "wrist")) not in pairs
    assert frozenset(("turntable", "upper_arm")) in pairs
    file.write_text(
        '<robot name="four"><disable_default_collisions link="wrist"/>'
        '<enable_collisions link1="base" link2="wrist"/></robot>'
    )
    pairs = names_of(read_tree(ROBOTS / "four.urdf", moving, srdf=file))
    assert {pair for pair in pairs if "wrist" in pair} == {frozenset(("base", "wrist"))}


def box(name, centre, size=(0.2, 0.2, 0.2), joint=-1):
    """A box of the surroundings."""
    placement = np.eye(4)
    placement[:3, 3] = centre
    return body_of(name, joint, Solid("box", size, placement, np.empty((0, 3)), np.empty((0, 3), dtype=np.int32)))


def half_space(name, height):
    """The half-space below a height."""
    placement = np.eye(4)
    placement[2, 3] = height
    return body_of(name, -1, Solid("half_space", (), placement, np.empty((0, 3)), np.empty((0, 3), dtype=np.int32)))


def test_obstacles_form_pairs_with_the_links_that_move_and_are_not_mounted():
    tree = read_tree(ROBOTS / "four.urdf", MOVING["four"])
    crate, shelf = box("crate", (1.0, 0, 0)), box("shelf", (-1.0, 0, 0))
    whole = with_obstacles(tree, [crate, shelf], ["turntable"])
    assert [body.name for body in whole.bodies[len(tree.bodies) :]] == ["crate", "shelf"]
    new = names_of(whole) - names_of(tree)
    assert new == {frozenset((link, name)) for link in ("upper_arm", "forearm", "wrist") for name in ("crate", "shelf")}
    more = with_obstacles(whole, [box("lamp", (0, 0, 3.0))])
    assert frozenset(("crate", "lamp")) not in names_of(more)
    assert frozenset(("turntable", "lamp")) in names_of(more)


def test_an_obstacle_that_touches_a_link_that_never_moves_is_an_error_unless_the_link_is_mounted():
    tree = read_tree(ROBOTS / "four.urdf", MOVING["four"])
    floor = half_space("floor", 0.01)
    with pytest.raises(InputError, match=r"link 'base', which does not move, touches floor: .*mounted = \['base'\]"):
        with_obstacles(tree, [floor])
    with_obstacles(tree, [floor], ["base"])
    with_obstacles(tree, [half_space("floor", -0.001)])
    with pytest.raises(InputError, match="touches crate"):
        with_obstacles(tree, [box("crate", (0.2, 0.0, 0.06))])
    # The corner of this box lies in the bounding box of the round base, but not in the base.
    with_obstacles(tree, [box("crate", (0.215, 0.215, 0.06))])


def test_an_obstacle_inside_a_mesh_that_never_moves_touches_it():
    tree = read_tree(ROBOTS / "elbow.urdf", ["elbow"])
    upper_arm = tree.tools["upper_arm"][1]
    with pytest.raises(InputError, match="link 'upper_arm', which does not move, touches pebble"):
        with_obstacles(tree, [box("pebble", upper_arm[:3, 3] + [0, 0, 0.1], (0.01, 0.01, 0.01))])
    with_obstacles(tree, [box("pebble", upper_arm[:3, 3] + [0, 0, 0.4], (0.01, 0.01, 0.01))], ["base"])


@pytest.mark.parametrize("name", MOVING)
def test_covers_contain_the_solids_of_own_robots(name):
    padding = 0.003
    tree = read_tree(ROBOTS / f"{name}.urdf", MOVING[name], padding=padding)
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, np.newaxis]
    for body in tree.bodies:
        points = surface_points(body.solid, rng)
        for piece in (body.hull, *body.pieces):
            assert piece.radius >= padding
        support = (body.hull.points @ directions.T).max(axis=0) + body.hull.radius
        assert ((points @ directions.T).max(axis=0) + padding <= support + 1e-12).all()


def surface_points(solid, rng):
    """Points on the surface of a solid, in the frame of its body."""
    if solid.kind == "mesh":
        local = solid.points
    elif solid.kind == "box":
        local = (rng.integers(0, 2, (50, 3)) - 0.5) * solid.size
    elif solid.kind == "ball":
        local = rng.normal(size=(500, 3))
        local *= solid.size[0] / np.linalg.norm(local, axis=1)[:, np.newaxis]
    else:
        assert solid.kind == "cylinder"
        angle = rng.uniform(0, 2 * np.pi, 500)
        height = rng.choice([-0.5, 0.5], 500) * solid.size[1]
        local = np.column_stack([solid.size[0] * np.cos(angle), solid.size[0] * np.sin(angle), height])
    return local @ solid.placement[:3, :3].T + solid.placement[:3, 3]


def test_without_an_srdf_only_links_that_one_joint_connects_are_left_out(tmp_path: Path) -> None:
    box = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    links = "".join(
        f'<link name="{name}">{"" if name == "flange" else box}</link>' for name in ("a", "b", "flange", "c", "d")
    )
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
    joints = "".join(
        f'<joint name="{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.3 0 0"/>{limit}</joint>'
        for parent, child, kind in (
            ("a", "b", "revolute"), ("b", "flange", "fixed"), ("flange", "c", "revolute"), ("b", "d", "fixed")
        )
    )  # fmt: skip
    (tmp_path / "r.urdf").write_text(f'<robot name="r">{links}{joints}</robot>')
    tree = read_tree(str(tmp_path / "r.urdf"), ("b", "c"), {})
    names = [body.name for body in tree.bodies]
    pairs = {frozenset(names[i] for i in pair) for pair in tree.pairs}
    assert pairs == {frozenset("ac"), frozenset("ad"), frozenset("cd")}
