"""`clrelight transfer` and `cr.transfer`: the same functions in a file and in memory, whatever is asked for."""

import json

import numpy as np
import pytest

import clrelight as cr
from clrelight import store
from clrelight.batch.single import run_single
from clrelight.jobs.surface import tracing
from clrelight.transfer import gathering
from clrelight.transfer.transport import transfer_vertices
from tests.commands import call, succeed
from tests.meshes import icosphere, open_box, quad
from tests.surfaces import make_grid, surface_content
from tests.test_batch import Here

pytest.importorskip("trimesh")
CONSTANT = np.sqrt(4 * np.pi)


def write_ply(path, surface, colours=None):
    lines = [f"ply\nformat ascii 1.0\nelement vertex {surface.n_vertex}"]
    lines += [f"property double {axis}" for axis in ("x", "y", "z", "nx", "ny", "nz")]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")] if colours is not None else []
    lines += [f"element face {len(surface.faces_f3)}\nproperty list uchar int vertex_indices\nend_header"]
    rows = np.concatenate([surface.vertices_v3, surface.normals_v3], axis=1).tolist()
    rows = rows if colours is None else [[*row, *colour] for row, colour in zip(rows, colours.tolist(), strict=True)]
    lines += [" ".join(map(repr, row)) for row in rows]
    lines += [f"3 {a} {b} {c}" for a, b, c in surface.faces_f3.tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    return write_ply(tmp_path_factory.mktemp("meshes") / "box.ply", open_box(4))


@pytest.mark.parametrize("kind", ["unshadowed", "shadowed", "interreflected"])
@pytest.mark.parametrize("frame", ["global", "local"])
def test_a_file_holds_what_the_verb_returns(box, tmp_path, kind, frame):
    asked = {"kind": kind, "frame": frame, "samples": 256, "degree": 3, "albedo": (0.9, 0.5, 0.1)}
    held = cr.transfer(box, report=cr.Report(), **asked)
    report = cr.transfer(box, out=tmp_path / "a.h5", report=cr.Report(), **asked)
    read = store.read_fit(tmp_path / "a.h5")
    np.testing.assert_array_equal(read.coeffs_khwc, held.coeffs_khwc)
    assert surface_content(read.surface) == surface_content(held.surface)
    assert (read.method, read.degree, read.peak, read.transfer, read.name) == ("transfer", 3, 1.0, "linear", "box")
    assert read.coeffs_khwc.shape == (16, held.surface.n_vertex, 1, 3)
    assert (read.surface.tangents_v3 is None) == (frame == "global")
    assert read.config["samples"] == 256
    expected = transfer_vertices(held.surface, 3, kind, 256)
    np.testing.assert_allclose(held.coeffs_khwc[:, :, 0], expected, atol=2e-6)
    assert report.facts["rays"] > 0 or kind == "unshadowed"


def test_commands(box, tmp_path):
    out = tmp_path / "a.h5"
    done = call("transfer", box, out, "--samples", 256)
    assert (done.code, done.err.startswith("note: it is open")) == (0, True)
    assert "vertices, 160 faces" in done.out
    assert "a second" in done.out
    told = succeed("transfer", box, out, "--type", "interreflected", "--samples", 256, "--json").json
    assert told["rays"] > 0
    assert 0.25 < told["energy"][0] < 0.5
    assert len(told["energy"]) == 4
    assert set(told["seconds"]) >= {"read", "trace", "write"}
    assert told["bytes_on_disk"] == out.stat().st_size
    options = "--type", "interreflected", "--shoot", "--threshold", "0.01", "--samples", 256, "--json"
    told = succeed("transfer", box, out, *options).json
    assert told["energy"][1] <= 0.01 * told["energy"][0]
    told = succeed("transfer", box, out, "--type", "unshadowed", "--albedo", "0.25", "--json").json
    assert told["rays"] == 0
    np.testing.assert_allclose(store.read_fit(out).coeffs_khwc[0] * CONSTANT, 0.25, rtol=1e-6)
    told = succeed("info", out, "--json").json
    assert told["surface"]["vertices"] == store.read_fit(out).surface.n_vertex
    assert "frame" in succeed("info", out).out


def test_colours_of_the_file(tmp_path):
    sphere = icosphere(1)
    colours = np.random.default_rng(2).integers(0, 256, (sphere.n_vertex, 3))
    path = write_ply(tmp_path / "a.ply", sphere, colours)
    held = cr.transfer(path, kind="unshadowed", albedo="file", report=cr.Report())
    value = colours / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(held.coeffs_khwc[0, :, 0] * CONSTANT, linear, atol=1e-5)
    assert cr.transfer(path, kind="unshadowed", report=cr.Report()).image_shape[2] == 1


def test_directions_of_a_stack(box, tmp_path):
    angle = np.radians(np.arange(0, 360, 20))
    azimuth, height = (each.ravel() for each in np.meshgrid(angle, [0.2, 0.8, 1.3]))
    flat = np.cos(height)
    lights = np.stack([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(height)], axis=1)
    (tmp_path / "dome.lp").write_text(
        f"{len(lights)}\n" + "\n".join(f"{i}.png {x:.9f} {y:.9f} {z:.9f}" for i, (x, y, z) in enumerate(lights)) + "\n"
    )
    report = cr.Report()
    held = cr.transfer(box, lights=tmp_path / "dome.lp", report=report)
    np.testing.assert_allclose(held.directions_i3, lights, atol=1e-8)
    assert any("do not cover the sphere" in note for note in report.notes)
    done = call("transfer", box, tmp_path / "a.h5", "--lights", tmp_path / "dome.lp", "--samples", 256)
    assert (done.code, done.err.count("\n")) == (2, 1)


def test_a_grid_keeps_its_rows(tmp_path):
    grid = make_grid(6, 9, argument="light")
    held = cr.transfer(grid, samples=64, degree=2, frame="local", report=cr.Report())
    assert held.coeffs_khwc.shape == (9, 6, 9, 3)
    np.testing.assert_array_equal(held.surface.tangents_v3, grid.tangents_v3)
    cr.transfer(grid, out=tmp_path / "g.h5", samples=64, degree=2, frame="local", memory="80k", report=cr.Report())
    read = store.read_fit(tmp_path / "g.h5")
    # Parts of other sizes, of which BLAS sums in another order on some processors.
    np.testing.assert_allclose(read.coeffs_khwc, held.coeffs_khwc, rtol=0, atol=1e-6)
    assert read.surface.grid == (6, 9)


def test_what_is_made_is_coded_as_any_fit(box, tmp_path):
    cr.transfer(box, out=tmp_path / "a.h5", samples=256, report=cr.Report())
    for codec in ("half", "uniform", "klt", "cpca"):
        cr.encode(tmp_path / "a.h5", codec, out=tmp_path / "e.h5", report=cr.Report())
        back = cr.decode(tmp_path / "e.h5", report=cr.Report())
        assert np.abs(back.coeffs_khwc - store.read_fit(tmp_path / "a.h5").coeffs_khwc).max() < 0.2


def test_light_from_everywhere_is_that_of_the_whole_sphere(box, tmp_path):
    rng = np.random.default_rng(8)
    sky = cr.Light(rng.random((16, 3)), "sky", "x", {})
    held = cr.transfer(box, out=tmp_path / "a.h5", samples=256, degree=3, report=cr.Report())
    held = store.read_fit(tmp_path / "a.h5")
    report = cr.Report()
    image = cr.relight(tmp_path / "a.h5", sky, report=report)
    expected = np.einsum("kv,kc->vc", held.coeffs_khwc[:, :, 0, 0].astype(np.float64), sky.coeffs_kc)
    np.testing.assert_allclose(image[:, 0], expected, atol=1e-5)
    assert not any("horizon" in note for note in report.notes)
    local = cr.transfer(box, samples=256, degree=3, frame="local", report=cr.Report())
    with pytest.raises(cr.InputError, match="own frame"):
        cr.relight(local, sky, report=cr.Report())


def test_little_memory_changes_nothing(tmp_path):
    path = write_ply(tmp_path / "a.ply", quad((0, 0, 0), (3, 0, 0), (0, 1, 0.4), 40, 30))
    for kind in ("shadowed", "interreflected"):
        whole = cr.transfer(path, kind=kind, samples=64, report=cr.Report())
        cr.transfer(path, kind=kind, samples=64, memory="64k", out=tmp_path / "a.h5", report=cr.Report())
        np.testing.assert_allclose(store.read_fit(tmp_path / "a.h5").coeffs_khwc, whole.coeffs_khwc, atol=2e-6)


@pytest.mark.parametrize(
    ("options", "phrase"),
    [
        (("--samples", 1000), "square count"),
        (("--samples", 4), "at least 16"),
        (("--degree", 101), "degree"),
        (("--albedo", "2"), "albedo must be from 0 to 1"),
        (("--albedo", "nan"), "albedo must be from 0 to 1"),
        (("--albedo", "1,1"), "three"),
        (("--albedo", "file"), "no colours"),
        (("--bounces", 2), "for --type interreflected"),
        (("--shoot",), "for --type interreflected"),
        (("--type", "interreflected", "--threshold", "2"), "threshold must be"),
        (("--type", "interreflected", "--shoot", "--threshold", "0"), "threshold must be"),
        (("--lights", "none.lp"), "none.lp"),
        (("--memory", "1k"), "--memory"),
        (("--type", "glossy"), "glossy"),
    ],
)
def test_wrong_requests_leave_what_there_was(box, tmp_path, options, phrase):
    out = tmp_path / "a.h5"
    out.write_text("as it was")
    done = call("transfer", box, out, *options)
    assert done.code == 2
    assert phrase in done.err
    assert out.read_text() == "as it was"
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_bad_meshes_end_in_one_line(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 nan\nf 1 2 3\n")
    done = call("transfer", tmp_path / "a.obj", tmp_path / "a.h5")
    assert (done.code, done.out) == (2, "")
    assert "vertex 2 is at 0 1 nan" in done.err
    assert call("transfer", tmp_path / "none.ply", tmp_path / "a.h5").code == 2
    assert not (tmp_path / "a.h5").exists()
    box = tmp_path / "a.ply"
    write_ply(box, open_box(2))
    done = call("transfer", box, box)
    assert done.code == 2
    assert box.read_text().startswith("ply")


def test_a_mesh_seen_from_behind_is_told_of(tmp_path):
    inside = icosphere(2, inside=True)
    turned = cr.Surface(inside.vertices_v3, inside.faces_f3[:, ::-1], inside.normals_v3)
    report = cr.Report()
    cr.transfer(turned, samples=64, report=report)
    assert any("from behind" in note for note in report.notes)
    assert report.facts["from_behind"] > 0.9
    assert json.dumps(report.to_json())


@pytest.mark.parametrize(
    "asked",
    [
        {"frame": "local", "albedo": (0.9, 0.5, 0.1), "samples": 64, "order": "morton"},
        {"kind": "unshadowed", "samples": 100, "memory": 1 << 20},
        {"kind": "interreflected", "samples": 64, "degree": 2, "albedo": (0.9, 0.5, 0.1), "frame": "local"},
        {"kind": "interreflected", "samples": 64, "degree": 2, "way": "shoot", "memory": 1 << 16},
    ],
)
def test_parts_by_workers(box, tmp_path, monkeypatch, asked):
    monkeypatch.setattr(gathering, "_TILE_VALUES", 1000)
    monkeypatch.setattr(tracing, "_PART_RAYS", 2000)
    one, two, engine = cr.Report(), cr.Report(), Here()
    cr.transfer(box, out=tmp_path / "one.h5", report=one, **asked)
    run_single("transfer", box, tmp_path / "two.h5", options=asked, engine=engine, report=two)
    assert (tmp_path / "two.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()
    assert len(engine.begun) > 2 + len(["closed"])
    skipped = ("file", "rays_per_second", "rays")
    assert two.facts["rays"] <= one.facts["rays"]  # what has no room in memory is traced again, or lies on the disk
    assert [{k: v for k, v in each.facts.items() if k not in skipped} for each in (one, two)] == 2 * [
        {k: v for k, v in one.facts.items() if k not in skipped}
    ]
    options = {"kind": "interreflected", "texels": (2, 2)}
    with pytest.raises(cr.InputError, match="interreflected transfer at texels is made by one process"):
        run_single("transfer", box, tmp_path / "x.h5", options=options, engine=Here())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.h5", "two.h5"]
