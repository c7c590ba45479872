"""Invalid URDF and SRDF files and arguments: one message each, with the problem, the place and a remedy.

Tests internals: `resgrid.robots.urdf.model`.
"""

import os
import sys
from pathlib import Path

import pytest

from resgrid.errors import InputError, ToolMissingError
from resgrid.robots.urdf.model import read_tree

ROBOTS = Path(__file__).resolve().parents[2] / "examples" / "robots"
FOUR = ROBOTS / "four.urdf"
BRACKET = (ROBOTS / "meshes" / "bracket.stl").read_bytes()


def link(name, inside=""):
    """A link element."""
    return f'<link name="{name}">{inside}</link>'


def joint(name, parent, child, kind="revolute", inside='<limit lower="-1" upper="1" effort="1" velocity="1"/>'):
    """A joint element."""
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def collision(geometry):
    """A collision element."""
    return f"<collision><geometry>{geometry}</geometry></collision>"


XACRO = "http://www.ros.org/wiki/xacro"
AB = link("a") + link("b")
LIMIT = '<limit lower="-1" upper="1"/>'
BAD_FILES = {
    "<robot><link": "not valid XML .*; repair the file",
    "": "not valid XML",
    "<sdf></sdf>": "the file describes no robot: its element is <sdf>, not <robot>",
    "<robot></robot>": "the robot has no links; is it the right file",
    f'<robot xmlns:xacro="{XACRO}"><xacro:macro/></robot>': "contains xacro macros; convert it first",
    AB + joint("j", "a", "c"): "joint 'j' refers to link 'c', which does not exist; define the link",
    link("base")
    + link("b")
    + joint("j", "bse", "b"): "refers to link 'bse', which does not exist; did you mean 'base'",
    AB
    + joint("j", "a", "b")
    + joint("k", "a", "b"): "link 'b' is the child of two joints, 'j' and 'k': kinematic loops",
    AB
    + joint("j", "a", "b")
    + joint("k", "b", "a"): "every link is the child of a joint: .* kinematic loop; open the loop",
    AB
    + link("c")
    + joint("j", "b", "c")
    + joint("k", "c", "b"): "joints j, k form a kinematic loop without the root 'a'",
    AB + link("c") + joint("j", "a", "b"): "several root links: a, c; connect them by joints",
    AB + link("a") + joint("j", "a", "b"): "link 'a' is defined more than once; give every link its own name",
    AB + link("c") + joint("j", "a", "b") + joint("j", "b", "c"): "joint 'j' is defined more than once",
    link("a") + "<link/>": "a link: <link> has no attribute 'name'; add name=",
    AB + joint("j", "a", "b", "hinge"): "joint 'j': unknown type 'hinge'; known types: revolute",
    AB + joint("j", "a", "b", "revolut"): "joint 'j': unknown type 'revolut'; did you mean 'revolute'",
    AB + '<joint name="j" type="fixed"><parent link="a"/></joint>': "joint 'j': no element <child>; add",
    AB
    + joint(
        "j", "a", "b", inside='<limit lower="1" upper="-1"/>'
    ): "the limits are reversed: lower = 1.0 .*; swap them",
    AB + joint("j", "a", "b", inside='<limit lower="x" upper="1"/>'): "joint 'j': lower = 'x' must be a finite number",
    AB + joint("j", "a", "b", inside='<limit upper="1" velocity="-1"/>'): "velocity = -1.0 must not be negative",
    AB
    + joint(
        "j", "a", "b", inside='<axis xyz="0 0 0"/>' + LIMIT
    ): "joint 'j': axis: axis = 0 0 0|axis = 0 0 0 has no direction",
    AB + joint("j", "a", "b", inside='<axis xyz="0 1"/>' + LIMIT): "axis: xyz = '0 1' must be 3 finite numbers",
    AB + joint("j", "a", "b", inside='<origin rpy="0 0 ${pi}"/>' + LIMIT): "xacro macros: convert it with xacro first",
    AB + joint("j", "a", "b", inside='<origin xyz="0 0 nan"/>' + LIMIT): "origin: xyz = '0 0 nan' must be 3 finite",
    AB + joint("j", "a", "b", inside=LIMIT + '<mimic joint="k"/>'): "joint 'j' mimics 'k', which does not exist",
    AB
    + joint(
        "j", "a", "b", inside=LIMIT + '<mimic joint="j"/>'
    ): "mimic joints follow each other: j -> j; remove a mimic",
    AB + joint("j", "a", "b", inside=""): "moving joint 'j' has no limits; add <limit",
    AB + joint("j", "a", "b", inside='<limit lower="0" upper="0"/>'): "has the range 0.0 to 0.0; widen it",
    AB
    + joint(
        "j", "a", "b", "fixed", ""
    ): "moving joint 'j' is fixed and cannot move as one axis; joints that can move: none",
    AB + joint("j", "a", "b", "floating", ""): "moving joint 'j' is floating and cannot move as one axis",
    AB + joint("j", "a", "b", "planar", ""): "moving joint 'j' is planar and cannot move as one axis",
    link("a", "<collision/>"): "link 'a': <collision> contains nothing; it needs one of box",
    link("a", collision("<cone/>")): "link 'a': <collision> contains <cone>; it needs one of box",
    link("a", collision("<box/>")): "link 'a': box: <box> has no attribute 'size'",
    link("a", collision('<box size="1 1 -1"/>')): "box: lengths 1.0 1.0 -1.0 must not be negative",
    link("a", collision('<sphere radius="0"/>')): "sphere: lengths 0.0 must not be negative, and not all of them 0",
    link("a", collision('<cylinder radius="1"/>')): "cylinder: <cylinder> has no attribute 'length'",
    link("a", collision('<mesh filename="m.stl" scale="1 0 1"/>')): "mesh: scale = '1 0 1' must not contain 0",
    link("a", collision("<mesh/>")): "mesh: <mesh> has no attribute 'filename'",
}


@pytest.mark.parametrize("text", BAD_FILES)
def test_an_invalid_file_gives_one_message_with_its_place(tmp_path, text, capfd):
    file = tmp_path / "robot.urdf"
    whole = text if text.startswith(("<robot", "<sdf")) or not text else f"<robot>{text}</robot>"
    if whole == "<robot>" + text + "</robot>" and "<joint" not in text:
        whole = whole.replace("</robot>", link("z") + joint("j", "a", "z") + "</robot>")
    file.write_text(whole)
    with pytest.raises(InputError, match=BAD_FILES[text]) as caught:
        read_tree(file, ["j"])
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


ARGUMENTS = [
    ({"moving": []}, "moving must name 1 to 4 joints, got 0 joints; joints that can move: turn, shoulder"),
    ({"moving": "turn"}, "moving must name 1 to 4 joints, got 'turn'"),
    ({"moving": ["turn", "shoulder", "elbow", "wrist", "mount"]}, "moving must name 1 to 4 joints, got 5 joints"),
    ({"moving": ["turn", "turn"]}, "moving names joint 'turn' more than once"),
    ({"moving": ["shuolder"]}, "moving names an unknown joint 'shuolder'; did you mean 'shoulder'"),
    ({"moving": ["zzz"]}, "unknown joint 'zzz'; joints of the file: turn, shoulder, elbow, wrist, mount"),
    ({"moving": ["mount"]}, "moving joint 'mount' is fixed and cannot move"),
    ({"at": {"elbw": 0.0}}, "at names an unknown joint 'elbw'; did you mean 'elbow'"),
    ({"at": {"turn": 0.0}}, "at: joint 'turn' is one of the moving joints; remove it"),
    ({"at": {"mount": 0.0}}, "at: joint 'mount' is fixed and has no value"),
    ({"at": {"elbow": 2.5}}, "at: joint 'elbow' = 2.5 lies outside its limits, -1.4 to 2.0"),
    ({"at": {"elbow": float("nan")}}, "at: joint 'elbow' = nan must be a finite number"),
    ({"padding": -0.01}, "padding = -0.01 must be a number of metres, at least 0"),
    ({"pieces": 0}, "pieces = 0 must be a whole number, at least 1"),
    ({"base": (0, 0, 0)}, "base = .* must be six finite numbers: x, y, z, roll, pitch, yaw"),
    ({"base": (0, 0, 0, 0, 0, float("inf"))}, "must be six finite numbers"),
    ({"mounted": ["bse"]}, "mounted names an unknown link 'bse'; did you mean 'base'"),
    ({"mounted": "base"}, r"mounted = 'base' must be a list of links: \['base'\]"),
    ({"srdf": ROBOTS / "gantry.srdf"}, "SRDF of another robot: the URDF has no link 'bridge', .*; give the SRDF that"),
    ({"srdf": ROBOTS / "none.srdf"}, "none.srdf: there is no such file"),
    ({"file": ROBOTS / "none.urdf"}, "none.urdf: there is no such file; check the name and the folder"),
    ({"file": ROBOTS}, "this is a directory; give the file inside it"),
]


@pytest.mark.parametrize(("changes", "message"), ARGUMENTS, ids=[message[:40] for _, message in ARGUMENTS])
def test_an_unsuitable_argument_gives_one_message(changes, message):
    options = {"file": FOUR, "moving": ["turn"], **changes}
    with pytest.raises(InputError, match=message):
        read_tree(options.pop("file"), options.pop("moving"), options.pop("at", None), **options)


def test_a_mimic_joint_cannot_move_and_has_no_value_of_its_own():
    with pytest.raises(InputError, match="'finger_right' follows joint 'finger_left'; name its driver instead"):
        read_tree(ROBOTS / "gantry.urdf", ["finger_right"])
    with pytest.raises(InputError, match="'finger_right' follows joint 'finger_left'; give the value of its driver"):
        read_tree(ROBOTS / "gantry.urdf", ["x"], {"finger_right": 0.0})


def test_an_srdf_file_with_one_unknown_link_suggests_its_name(tmp_path):
    file = tmp_path / "four.srdf"
    file.write_text('<robot name="four"><disable_collisions link1="bsae" link2="wrist"/></robot>')
    with pytest.raises(InputError, match="the URDF has no link 'bsae'; did you mean 'base'"):
        read_tree(FOUR, ["turn"], srdf=file)


def with_mesh(folder, address):
    """A robot with one mesh, in a folder."""
    file = folder / "robot.urdf"
    mesh = collision(f'<mesh filename="{address}"/>')
    file.write_text(f"<robot>{link('a', mesh)}{link('b')}{joint('j', 'a', 'b')}</robot>")
    return file


def test_a_missing_mesh_names_the_tried_path(tmp_path):
    file = with_mesh(tmp_path, "meshes/part.stl")
    with pytest.raises(
        InputError, match=rf"link 'a': mesh: there is no file for 'meshes/part.stl'; tried {tmp_path}/meshes"
    ):
        read_tree(file, ["j"])
    file = with_mesh(tmp_path, "file:///nowhere/part%20a.stl")
    with pytest.raises(InputError, match=r"tried /nowhere/part a\.stl"):
        read_tree(file, ["j"])


def test_an_unresolved_package_names_the_searched_folders(tmp_path, monkeypatch):
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    file = with_mesh(tmp_path, "package://my_robot/part.stl")
    with pytest.raises(InputError, match=r"package 'my_robot' of .* not found in packages \(none were given\)"):
        read_tree(file, ["j"])
    with pytest.raises(
        InputError, match=rf"not found in packages \({tmp_path}\).*add the folder that contains 'my_robot'"
    ):
        read_tree(file, ["j"], packages=[tmp_path])
    with pytest.raises(InputError, match=r"unknown scheme in 'http://x/part\.stl'; use package://"):
        read_tree(with_mesh(tmp_path, "http://x/part.stl"), ["j"])


@pytest.mark.parametrize("way", ["parent of it", "itself", "above", "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
def test_a_package_is_found_in_given_folders_above_the_file_and_in_the_environment(tmp_path, monkeypatch, way):
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    share = tmp_path / "ws" / "share"
    package = share / "my_robot"
    (package / "urdf").mkdir(parents=True)
    (package / "part.stl").write_text((ROBOTS / "meshes" / "bracket.stl").read_text())
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    packages = {"parent of it": [share], "itself": [str(package)]}.get(way, [])
    if way == "ROS_PACKAGE_PATH":
        monkeypatch.setenv(way, os.pathsep.join(["/nowhere", str(share)]))
    elif way == "AMENT_PREFIX_PATH":
        monkeypatch.setenv(way, str(tmp_path / "ws"))
    file = with_mesh(package / "urdf" if way == "above" else elsewhere, "package://my_robot/part.stl")
    tree = read_tree(file, ["j"], packages=packages, pieces=1)
    assert len(tree.bodies[0].solid.triangles) == 20


BAD_MESHES = {
    ("part.step", b"ISO-10303-21;"): "unknown mesh format '.step'; convert the mesh to one of .stl, .obj, .ply, .dae",
    ("part.stl", b""): "cannot be read as STL .0 bytes are no whole number of triangles",
    ("part.stl", b"solid x\nendsolid x\n"): "the mesh has no triangles; is it the right file",
    ("part.stl", b"\0" * 80 + b"\x09\0\0\0" + b"\0" * 50): "cannot be read as STL .134 bytes are no whole number",
    (
        "part.stl",
        BRACKET[: len(BRACKET) // 2],
    ): "cannot be read as STL .the file ends or is interrupted after 10 complete",
    ("part.stl", BRACKET.replace(b"endsolid bracket", b"")): "interrupted after 20 complete triangles",
    ("part.stl", BRACKET.replace(b"endloop", b"", 1)): "interrupted after 19 complete triangles",
    ("part.stl", BRACKET.replace(b"-22", b"minus", 1)): "a coordinate is no number",
    ("part.stl", BRACKET.replace(b"-22", b"inf", 1)): r"vertex \d+ = .*inf.* is not finite; repair the mesh",
    ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"): "the mesh has no triangles; is it the right file",
    ("part.obj", b"v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n"): "line 2: a vertex has no three numbers",
    ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2"): "line 5: a face has 2 corners; the mesh is damaged",
    ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 \\\n2 3\nf 1 2 x"): "line 6: corner 'x' has no vertex number",
    ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n"): "line 4: corner '0' refers to a vertex that does not",
    ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n"): "line 4: corner '-4' refers to a vertex that does not",
    ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999\n"): "line 4: corner '99999999999' refers to",
    ("part.obj", b"v 0 0 0\nsurf 0 1 0 1 1 2 3 4\n"): "line 2: 'surf' is no polygon; export the mesh as triangles",
    ("part.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"): r"vertex \d = .*nan.* is not finite; repair the mesh",
    (
        "part.obj",
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    ): "a triangle refers to a vertex that does not exist|cannot be read",
    ("part.dae", b"<COLLADA/>"): "the mesh cannot be read as COLLADA .it has no scene",
    ("part.dae", b"<COLLADA"): "the mesh is not valid XML",
}


@pytest.mark.parametrize(("name", "data"), BAD_MESHES, ids=lambda value: str(value)[-20:])
def test_a_damaged_mesh_gives_one_message(tmp_path, name, data, capfd):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=BAD_MESHES[name, data]) as caught:
        read_tree(with_mesh(tmp_path, name), ["j"])
    assert "link 'a'" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


TRIANGLE = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""


def test_meshes_without_trimesh_name_the_command_that_installs_it(tmp_path, monkeypatch):
    (tmp_path / "part.ply").write_text(TRIANGLE)
    assert len(read_tree(with_mesh(tmp_path, "part.ply"), ["j"]).bodies[0].solid.triangles) == 1
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ToolMissingError, match=r"PLY files need trimesh; install it: .*pip install"):
        read_tree(with_mesh(tmp_path, "part.ply"), ["j"])
    read_tree(ROBOTS / "elbow.urdf", ["turn"], pieces=1)
