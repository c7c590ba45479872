"""Mesh files: STL, OBJ, PLY and COLLADA, and their agreement; damaged COLLADA files.

Tests internals: `resgrid.robots.mesh_files`, `resgrid.robots.collada`.
"""

from importlib import import_module

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from resgrid.errors import InputError
from resgrid.robots.collada import read_collada
from resgrid.robots.mesh_files import read_mesh

trimesh = import_module("trimesh")

POSITIONS = "0 0 0  1 0 0  1 1 0  0 1 0  0 0 1  1 0 1  1 1 1  0 1 1"
FACES = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]


def document(primitive, nodes='<node><instance_geometry url="#g"/></node>', asset="", positions=POSITIONS, extra=""):
    """A COLLADA file with one geometry, whose vertices are the corners of a cube."""
    count = len(positions.split()) // 3
    return f"""<?xml version="1.0"?>
    <COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
    <asset><created>2026-01-01T00:00:00</created><modified>2026-01-01T00:00:00</modified>{asset}</asset>
    <library_geometries><geometry id="g" name="g"><mesh>
    <source id="s"><float_array id="a" count="{3 * count}">{positions}</float_array><technique_common>
    <accessor source="#a" count="{count}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
    <param name="Z" type="float"/></accessor></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>{primitive}</mesh></geometry>{extra}
    </library_geometries>
    <library_visual_scenes><visual_scene id="scene">{nodes}</visual_scene></library_visual_scenes>
    <scene><instance_visual_scene url="#scene"/></scene></COLLADA>""".encode()


VERTEX = '<input semantic="VERTEX" source="#v" offset="0"/>'
CUBE = " ".join(str(index) for face in FACES for index in face)
POLYLIST = f'<polylist count="6">{VERTEX}<vcount>4 4 4 4 4 4</vcount><p>{CUBE}</p></polylist>'
ROWS = "".join(f"<p>{a} {b} {c} {d}</p>" for a, b, c, d in FACES)
POLYGONS = f'<polygons count="6">{VERTEX}{ROWS}</polygons>'
TRIANGLES = (
    f'<triangles count="12"><input semantic="NORMAL" source="#s" offset="0"/>{VERTEX.replace("0", "1")}<p>'
    + " ".join(f"0 {a} 0 {b} 0 {c} 0 {a} 0 {c} 0 {d}" for a, b, c, d in FACES)
    + "</p></triangles>"
)
STRIPS = f'<tristrips count="6">{VERTEX}{"".join(f"<p>{a} {b} {d} {c}</p>" for a, b, c, d in FACES)}</tristrips>'
FANS = f'<trifans count="6">{VERTEX}{ROWS}</trifans>'


def volume_and_area(points, triangles):
    """Absolute signed volume, which strips may lose, and area of a surface."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    return abs(np.einsum("tk,tk->", a, normal)) / 6, np.linalg.norm(normal, axis=1).sum() / 2


@pytest.mark.parametrize("primitive", [POLYLIST, POLYGONS, TRIANGLES, STRIPS, FANS])
def test_all_primitives_of_collada_give_the_surface(primitive):
    points, triangles = read_collada(document(primitive), "cube.dae")
    assert len(triangles) == 12
    volume, area = volume_and_area(points, triangles)
    assert area == pytest.approx(6.0)
    if primitive is not STRIPS:
        assert volume == pytest.approx(1.0)


NODES = """<node id="n"><matrix>1 0 0 2  0 0 -1 0.5  0 1 0 0  0 0 0 1</matrix>
  <node><translate>0 0 1</translate><rotate>0 0 1 30</rotate><scale>1 2 3</scale><instance_geometry url="#g"/></node>
</node><node><translate>-3 0 0</translate><instance_geometry url="#g"/></node>"""


def test_nodes_of_collada_place_geometries_in_the_order_of_their_transformations():
    points, triangles = read_collada(document(TRIANGLES, NODES), "cube.dae")
    assert len(triangles) == 24
    cube = np.array(POSITIONS.split(), dtype=float).reshape(-1, 3)
    turned = Rotation.from_euler("z", 30, degrees=True).apply(cube * [1, 2, 3]) + np.array([0, 0, 1])
    first = Rotation.from_euler("x", 90, degrees=True).apply(turned) + np.array([2, 0.5, 0])
    np.testing.assert_allclose(points, np.concatenate([first, cube + np.array([-3, 0, 0])]), atol=1e-12)


def test_the_unit_of_collada_is_applied_and_the_up_axis_is_ignored():
    asset = '<unit meter="0.001" name="millimetre"/><up_axis>Y_UP</up_axis>'
    points, _ = read_collada(document(POLYLIST, asset=asset), "cube.dae")
    np.testing.assert_allclose(points.max(axis=0), 0.001)


def test_a_missing_material_or_texture_drops_no_geometry():
    instance = (
        '<node><instance_geometry url="#g"><bind_material><technique_common>'
        '<instance_material symbol="m" target="#none"/>'
        "</technique_common></bind_material></instance_geometry></node>"
    )
    _, triangles = read_collada(document(POLYLIST, instance), "cube.dae")
    assert len(triangles) == 12


DAMAGED = {
    document(POLYLIST, '<node><instance_geometry url="#h"/></node>'): "it refers to '#h', which does not exist",
    document(POLYLIST, '<node><instance_controller url="#g"/></node>'): "it contains a skin or morph; bake the shape",
    document(POLYLIST, '<node id="n"><instance_node url="#n"/></node>'): "its nodes refer to each other",
    document(POLYLIST, "<node><matrix>1 2</matrix></node>"): "<matrix> has 2 numbers instead of 16",
    document(POLYLIST, "<node><skew>1 2</skew></node>"): "<skew> is not supported",
    document(POLYLIST.replace("4 4 4 4 4 4", "4 4 4")): "<polylist> has a wrong number of corners",
    document(POLYLIST.replace("7</p>", "8</p>")): "a triangle refers to a vertex that does not exist",
    document(POLYLIST.replace("7</p>", "4294967303</p>")): "a triangle refers to a vertex that does not exist",
    document(POLYLIST.replace("4 4 4 4 4 4", "4 4 4 4 4 5 -1")): "<polylist> has a wrong number of corners",
    document(POLYLIST.replace("7</p>", "x</p>")): "<p> holds text that is no number",
    document(POLYLIST.replace("#v", "#w")): "it refers to '#w', which does not exist",
    document(POLYLIST.replace("VERTEX", "NORMAL")): "<polylist> has no vertices",
    document(POLYGONS.replace("<p>0 3 2 1</p>", "<ph><p>0 3 2 1</p></ph>")): "a polygon has holes",
    document(TRIANGLES.replace("</p>", " 0</p>")): "<triangles> ends within a corner",
    document(TRIANGLES.replace("</p>", " 0 1</p>")): "<triangles> ends within a triangle",
    document(TRIANGLES.replace('offset="1"', 'offset="x"')): "<input offset='x'> is not a whole number",
    document(POLYLIST.replace("7</p>", "9" * 30 + "</p>")): "<p> holds text that is no number",
    document(POLYLIST, asset='<unit meter="inch"/>'): "its unit is not a positive number of metres",
    document("<spline/>"): "<spline> is not supported",
    document(POLYLIST).replace(b'count="8"', b'count="9"'): "has fewer numbers than its accessor",
    document(POLYLIST, '<node><instance_geometry url="#t"/></node>', extra='<geometry id="t"><spline/></geometry>'): (
        "geometry 't' is not a mesh"
    ),
    b"<COLLADA>\xff</COLLADA>": "is not valid XML",
    b"<html/>": "it has no scene",
}


@pytest.mark.parametrize("data", DAMAGED, ids=list(DAMAGED.values()))
def test_collada_that_cannot_be_read_completely_is_an_error(data):
    with pytest.raises(InputError, match=rf"^part\.dae: the mesh .*{DAMAGED[data]}.*; export it again"):
        read_collada(data, "part.dae")


@pytest.mark.parametrize("suffix", ["stl", "stl_ascii", "obj", "ply"])
def test_a_mesh_is_the_same_in_every_format(tmp_path, suffix):
    sphere = trimesh.creation.icosphere(2, 0.25)
    file = tmp_path / f"ball.{suffix.partition('_')[0].upper()}"
    sphere.export(file, file_type=suffix)
    points, triangles = read_mesh(file)
    assert (len(points), len(triangles)) == (len(sphere.vertices), len(sphere.faces))
    assert volume_and_area(points, triangles) == pytest.approx((sphere.volume, sphere.area), rel=1e-5)
    assert triangles.dtype == np.int32


def test_polygons_and_negative_indices_of_obj_files_are_read(tmp_path):
    file = tmp_path / "cube.obj"
    rows = np.array(POSITIONS.split()).reshape(-1, 3)
    lines = [f"v {' '.join(row)}" for row in rows] + ["mtllib none.mtl", "usemtl none"]
    lines += [f"f {' '.join(str(index + 1) for index in face)}" for face in FACES[:3]]
    lines += [f"f {' '.join(f'{index - 8}' for index in face)}" for face in FACES[3:]]
    file.write_text("\n".join(lines) + "\n")
    points, triangles = read_mesh(file)
    assert volume_and_area(points, triangles) == pytest.approx((1.0, 6.0))


def test_negative_indices_count_back_from_the_face_and_lines_may_be_continued(tmp_path):
    file = tmp_path / "two.obj"
    first = "v 0 0 0 1 1 1\nv 1 0 0\nv 1 1 0 1.0\nf -3//1 -2//1 \\\n  -1//1 # comment\n"
    file.write_text(f"o a\n{first}o b\nvt 0 0\nv 0 0 2\nv 1 0 2\nv 1 1 2\n\tf -3/1 -2/1 -1/1\nl 1 2\n")
    points, triangles = read_mesh(file)
    heights = sorted(points[triangle, 2].tolist() for triangle in triangles)
    assert heights == [[0, 0, 0], [2, 2, 2]]


def test_a_pentagon_of_an_obj_file_loses_no_corner(tmp_path):
    file = tmp_path / "flat.obj"
    file.write_text("v 0 0 0\nv 2 0 0\nv 3 1 0\nv 1 3 0\nv -1 1 0\nf 1 2 3 4 5\n")
    points, triangles = read_mesh(file)
    assert volume_and_area(points, triangles)[1] == pytest.approx(7.0)
