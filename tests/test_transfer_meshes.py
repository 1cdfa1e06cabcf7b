"""Meshes of files: all formats give the same surface, and whatever is wrong is dropped, made, noted or refused."""

import io

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.transfer.mesh_files import FORMATS, read_mesh
from clrelight.transfer.meshes import make_surface, merge_positions, vertex_areas
from tests.meshes import icosphere, joined, quad

trimesh = pytest.importorskip("trimesh")

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
element face 1
property list uchar int vertex_indices
end_header
0 0 0 0 0 2 255 0 0
1 0 0 0 0 1 255 0 0
1 1 0 0 0 1 255 128 0
0 1 0 0 0 1 255 0 0
4 0 1 2 3
"""
OBJ = "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl a\n"
SQUARE = OBJ + "f 1/1 2/2 3/3 4/4\n"


def put(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def exported(surface, kind):
    mesh = trimesh.Trimesh(surface.vertices_v3, surface.faces_f3, process=False)
    content = mesh.export(file_type=kind)
    return content if isinstance(content, bytes) else content.encode()


def corners(surface):
    """Return the triangles by their corners' positions, in an order that says nothing of the file's."""
    triangles = np.round(surface.vertices_v3[surface.faces_f3], 5) + 0.0
    turned = [min(tuple(map(tuple, np.roll(t, -i, axis=0))) for i in range(3)) for t in triangles]
    return sorted(turned)


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_holds_the_same_sphere(tmp_path, kind):
    sphere = icosphere(2)
    found = read_mesh(put(tmp_path, f"ball.{kind.upper()}", exported(sphere, kind)), up="z")
    assert found.name == "ball"
    assert found.n_vertex == sphere.n_vertex
    assert corners(found) == corners(sphere)
    assert (np.einsum("va,va->v", found.normals_v3, found.vertices_v3) > 0.999).all()
    assert ("became the vertices" in " ".join(found.notes)) == (kind == "stl")
    assert not any("open" in note or "inside out" in note for note in found.notes)
    np.testing.assert_allclose(vertex_areas(found).sum(), 4 * np.pi, rtol=0.05)


def test_normals_colours_and_polygons_of_a_ply(tmp_path):
    path = put(tmp_path, "a.ply", PLY)
    found = read_mesh(path, colors=True)
    assert (found.n_vertex, len(found.faces_f3)) == (4, 2)
    np.testing.assert_allclose(found.normals_v3, np.tile([0, 0, 1.0], (4, 1)))
    np.testing.assert_allclose(found.albedo_vc[2], [1, ((128 / 255 + 0.055) / 1.055) ** 2.4, 0], atol=1e-6)
    assert found.notes == ("it is open: 4 edges have one face, and its back may be seen",)
    assert read_mesh(path).albedo_vc is None
    with pytest.raises(InputError, match=r"a\.off: it holds no colours"):
        read_mesh(put(tmp_path, "a.off", exported(icosphere(1), "off")), colors=True)
    mesh = trimesh.Trimesh(icosphere(1).vertices_v3, icosphere(1).faces_f3, process=False)
    mesh.visual.vertex_colors = np.tile(np.array([[0, 128, 255, 255]], np.uint8), (len(mesh.vertices), 1))
    found = read_mesh(put(tmp_path, "c.glb", mesh.export(file_type="glb")), colors=True)
    np.testing.assert_allclose(found.albedo_vc[0], [0, 128 / 255, 1], atol=1e-6)  # linear there


def test_texture_coordinates_stay_and_seams_are_no_holes(tmp_path):
    found = read_mesh(put(tmp_path, "a.obj", SQUARE))
    assert found.texture_v2.shape == (4, 2)
    assert {tuple(uv) for uv in found.texture_v2} == {(0, 0), (1, 0), (1, 1), (0, 1)}
    tent = OBJ + "v 0 0 1\nf 1/1 2/2 5/3\nf 2/1 3/2 5/3\nf 3/1 4/2 5/3\nf 4/1 1/2 5/3\nf 4/1 3/2 2/3 1/4\n"
    found = read_mesh(put(tmp_path, "tent.obj", tent))
    assert found.n_vertex > 5
    assert not any("open" in note for note in found.notes)
    places = merge_positions(found.vertices_v3)[1]
    for place in range(5):
        assert np.ptp(found.normals_v3[places == place], axis=0).max() < 1e-12


def test_scenes_become_one_surface(tmp_path):
    scene = trimesh.Scene()
    ball = trimesh.Trimesh(icosphere(1).vertices_v3, icosphere(1).faces_f3, process=False)
    for x in (0.0, 3.0):
        scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    mirrored = np.diag([-2.0, 2.0, 2.0, 1.0])
    mirrored[0, 3] = 9.0
    scene.add_geometry(ball, transform=mirrored)
    found = read_mesh(put(tmp_path, "three.glb", scene.export(file_type="glb")))
    assert found.n_vertex == 3 * len(ball.vertices)
    assert found.notes[:2] == ("its 3 meshes are taken as one", "y is up: turned so that z is")
    centres = found.vertices_v3.reshape(3, -1, 3).mean(axis=1)
    assert sorted(np.round(centres[:, 0], 5)) == [0, 3, 9]
    for centre, start in zip(centres, range(0, found.n_vertex, len(ball.vertices)), strict=True):
        part = slice(start, start + len(ball.vertices))
        outward = found.vertices_v3[part] - centre
        assert (np.einsum("va,va->v", outward, found.normals_v3[part]) > 0.9).all()


def test_y_becomes_z(tmp_path):
    path = put(tmp_path, "a.obj", "v 0 5 0\nv 0 5 1\nv 1 5 0\nf 1 2 3\n")
    found = read_mesh(path, up="y")
    np.testing.assert_allclose(found.vertices_v3[:, 2], 5)
    np.testing.assert_allclose(found.normals_v3, np.tile([0, 0, 1.0], (3, 1)), atol=1e-12)
    assert (read_mesh(path).vertices_v3[:, 1] == 5).all()
    with pytest.raises(InputError, match="up must be"):
        read_mesh(path, up="x")


def notes_of(vertices, faces, normals=None, **more):
    return make_surface(np.asarray(vertices, np.float64), np.asarray(faces), normals, **more)


SHEET = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))


def test_what_cannot_be_used_is_dropped_and_what_is_missing_made():
    flat = [[0, 1, 1], [0, 1, 4]]
    vertices = [*SHEET.vertices_v3, [0.5, 0, 0], [9, 9, np.nan]]
    found = notes_of(vertices, [*SHEET.faces_f3, *flat])
    assert (found.n_vertex, len(found.faces_f3)) == (4, 2)
    assert found.notes[0] == "2 faces without area dropped"
    assert found.notes[1].startswith("2 vertices of no face are dropped")
    assert "it has no normals: they are made from its faces" in found.notes
    normals = np.tile([0, 0, 3.0], (4, 1))
    normals[1], normals[2] = 0, np.nan
    found = notes_of(SHEET.vertices_v3, SHEET.faces_f3, normals)
    assert "2 normals are missing, and are made from the faces" in found.notes
    np.testing.assert_allclose(found.normals_v3, np.tile([0, 0, 1.0], (4, 1)))
    # by areas: the large face counts more
    found = notes_of([[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 1], [0, 1, 0]], [[0, 1, 2], [0, 4, 3]])
    expected = np.array([0.5, 0, 8.0]) / np.hypot(0.5, 8)
    np.testing.assert_allclose(found.normals_v3[0], expected, atol=1e-12)


def test_odd_shapes_are_noted():
    sphere = icosphere(1)
    inside = notes_of(sphere.vertices_v3, sphere.faces_f3[:, ::-1])
    assert any("inside out" in note for note in inside.notes)
    far = notes_of(sphere.vertices_v3 + 1e7, sphere.faces_f3, sphere.normals_v3)
    assert not any("inside out" in note for note in far.notes)
    fin = notes_of([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert "it is no manifold: 1 edges have more than two faces" in fin.notes
    torn = notes_of(SHEET.vertices_v3, [SHEET.faces_f3[0], SHEET.faces_f3[1][::-1]])
    assert "1 edges have two faces that are turned against each other" in torn.notes
    back = notes_of(SHEET.vertices_v3, np.concatenate([SHEET.faces_f3, SHEET.faces_f3[:, ::-1]]))
    assert any("back to back" in note for note in back.notes)
    np.testing.assert_allclose(np.abs(back.normals_v3[:, 2]), 1)
    two = joined(icosphere(1), icosphere(1, centre=(0.5, 0, 0)))
    assert notes_of(two.vertices_v3, two.faces_f3, two.normals_v3).notes == ()


@pytest.mark.parametrize(
    ("name", "content", "phrase"),
    [
        ("a.txt", PLY, "ends in '.txt'"),
        ("a", PLY, "ends in ''"),
        ("a.stp", PLY, "meshes are read from ply, obj, stl, off, glb"),
        ("a.ply", "", "is empty"),
        ("a.ply", OBJ, "no PLY"),
        ("a.glb", PLY, "no GLB"),
        ("a.stl", b"\x00" * 50, "cut short|nothing"),
        ("a.off", PLY, "no OFF"),
        ("a.ply", PLY.replace("face 1", "face 0").replace("4 0 1 2 3\n", ""), "4 points and no faces"),
        ("a.obj", "v 0 0 0\nv 1 1 1\n", "2 points and no faces"),
        ("a.obj", "hello\n", "holds nothing"),
        ("a.obj", SQUARE.replace("v 0 0 0", "v 0 nan 0"), "vertex 0 is at 0 nan 0, expected finite"),
        ("a.obj", SQUARE.replace("v 0 0 0", "v 0 inf 0"), "vertex 0 is at 0 inf 0"),
        ("a.obj", SQUARE.replace("v 0 0 0", "v 0 1e200 0"), r"1e\+200"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "out of bounds|faces name"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "none of its 1 faces has an area"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 9\n", "outside the range|faces name"),
        ("a.ply", PLY.replace("vertex 4", "vertex 4000000000"), "cut short|claims"),
        ("a.ply", PLY.replace("vertex 4", "vertex -4"), "cut short|holds"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, name, content, phrase):
    path = put(tmp_path, name, content)
    with pytest.raises(InputError, match=phrase) as caught:
        read_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="cannot read"):
        read_mesh(tmp_path / "none.ply")
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(InputError, match="cannot read"):
        read_mesh(tmp_path / "folder.ply")


@pytest.mark.parametrize("kind", FORMATS)
def test_cut_and_damaged_files_are_refused_or_read(tmp_path, kind):
    """Whatever the bytes: a surface or an InputError in one line."""
    good = exported(icosphere(1), kind)
    rng = np.random.default_rng(6)
    read = 0
    for number in range(60):
        bad = bytearray(good)
        if number % 2:
            del bad[int(rng.integers(len(bad))) :]
        else:
            for at in rng.integers(len(bad), size=3):
                bad[at] = rng.integers(256)
        try:
            read_mesh(put(tmp_path, f"a.{kind}", bytes(bad)))
            read += 1
        except InputError as error:
            if "\n" in str(error):
                raise
    assert read < 60


def test_a_mesh_reads_no_other_file(tmp_path, monkeypatch):
    opened = []
    keep = io.open

    def watched(file, *args, **kwargs):
        opened.append(str(file))
        return keep(file, *args, **kwargs)

    put(tmp_path, "gone.mtl", "newmtl a\nmap_Kd secret.png\n")
    path = put(tmp_path, "a.obj", SQUARE)
    monkeypatch.setattr("builtins.open", watched)
    read_mesh(path)
    assert not any("gone" in name or "secret" in name for name in opened)


def test_positions_are_merged_in_their_order():
    positions = np.array([[1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0.0, -0.0], [2, 0, 0]])
    first, same = merge_positions(positions)
    assert first.tolist() == [0, 1, 4]
    assert same.tolist() == [0, 1, 0, 1, 2]
