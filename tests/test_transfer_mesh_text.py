"""Mesh files in odd but sound texts are read as they are meant; those that were cut short are refused."""

import struct

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.transfer.mesh_files import read_mesh

pytest.importorskip("trimesh")

V = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
F = ["0 2 1", "0 1 3", "0 3 2", "1 2 3"]
OBJ = "".join(f"v {v}\n" for v in V) + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
OFF = "OFF\n4 4 6\n" + "".join(f"{v}\n" for v in V) + "".join(f"3 {f}\n" for f in F)
HEAD = """ply
format ascii 1.0
comment made by hand
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
"""
PLY = HEAD + "".join(f"{v}\n" for v in V) + "".join(f"3 {f}\n" for f in F)


def stl(header):
    corners = np.array([[float(x) for x in v.split()] for v in V], np.float32)
    faces = [corners[[int(i) for i in f.split()]] for f in F]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *face.ravel(), 0) for face in faces)
    return header.ljust(80, b" ") + struct.pack("<I", len(faces)) + body


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("latin.obj", b"# cr\xe9\xe9 \xe0 la main\n" + OBJ.encode()),
        ("mark.obj", b"\xef\xbb\xbf" + OBJ.encode()),
        ("tabs.obj", OBJ.replace(" ", "\t").encode()),
        ("old.obj", OBJ.replace("\n", "\r").encode()),
        ("latin.off", OFF.encode().replace(b"4 4 6", b"# \xe9\n4 4 6")),
        ("latin.ply", PLY.encode().replace(b"made by hand", b"\xe9\xe8")),
        ("colour.stl", stl(b"COLOR=\xff\x80\x00\xff,MATERIAL=\xe9")),
        ("solid.stl", stl(b"solid by some program")),
    ],
)
def test_texts_of_any_encoding_and_line_ends(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    surface = read_mesh(tmp_path / name)
    assert (surface.n_vertex, len(surface.faces_f3)) == (4, 4)


def test_faces_of_an_obj_count_back_from_their_own_line(tmp_path):
    """The format's negative numbers are relative to the vertices read so far: trimesh takes all of the file's."""
    low, high = ("".join(f"v {v} {z}\nvt {v}\n" for v in ("0 0", "1 0", "0 1")) for z in (0, 5))
    face = "f -3/-3 -2/-2 -1/-1\n"
    (tmp_path / "two.obj").write_text(low + face + high + face)
    surface = read_mesh(tmp_path / "two.obj")
    assert surface.n_vertex == 6
    assert sorted(surface.vertices_v3[surface.faces_f3][:, :, 2].mean(axis=1)) == [0.0, 5.0]
    np.testing.assert_array_equal(surface.texture_v2, surface.vertices_v3[:, :2])


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("zero.obj", OBJ + "f 0 1 2\n", "a face names v 0, they count from 1, or back from -1"),
        ("zero.obj", OBJ + "vt 0 0\nf 1/0 2/1 3/1\n", "a face names vt 0"),
        ("before.obj", OBJ + "f -5 2 3\n", "a face names v -5, there are 4 before it"),
        ("lines.ply", PLY[: PLY.rindex("3 1 2 3")], "cut short: its header says 8 vertices and faces, 7 lines follow"),
        ("word.ply", PLY[:-3], "cut short: its last face has 2 of 3 vertices"),
        ("head.ply", HEAD[:-12], "cut short: its header has no end"),
        ("lines.off", OFF[: OFF.rindex("3 1 2 3")], "its header says 8 vertices and faces, 7 lines follow"),
        ("word.off", OFF[:-3], "cut short: its last face has 2 of 3 vertices"),
    ],
)
def test_what_is_cut_short_or_counts_wrongly_is_refused(tmp_path, name, content, says):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=says):
        read_mesh(tmp_path / name)


def test_bytes_at_random_are_no_mesh(tmp_path):
    noise = np.random.default_rng(1).integers(0, 256, 4000, np.uint8).tobytes()
    for kind, content in (*((kind, noise) for kind in ("obj", "stl", "off", "ply", "glb")), ("stl", stl(b"\xe9")[:-7])):
        (tmp_path / f"noise.{kind}").write_bytes(content)
        with pytest.raises(InputError, match=f"noise.{kind}") as refused:
            read_mesh(tmp_path / f"noise.{kind}")
        assert "No module" not in str(refused.value)
