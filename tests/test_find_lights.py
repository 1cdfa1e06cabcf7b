"""Lights by spheres in photographs, and by objects: against photographs rendered by code of the tests alone."""

import csv
import warnings

import numpy as np
import pytest
from scipy import ndimage

import clrelight as cr
from clrelight import image_sink
from clrelight.images import read_image, write_image
from clrelight.jobs.variation import light_frames
from clrelight.light_files import read_light_file
from clrelight.sampling import make_pattern
from clrelight.variation.factoring import lights_from_surface
from clrelight.variation.shading import lights_from_normals
from tests.commands import call, contents, succeed
from tests.reference.spheres import lamps, photograph_spheres, srgb_codes

BALL = (82.3, 55.6, 40.2)
SIZE = (112, 150)


def write_photographs(folder, photographs_ihw, ending="jpg"):
    folder.mkdir()
    for i, codes in enumerate(srgb_codes(photographs_ihw)):
        write_image(folder / f"photo{i:02d}.{ending}", codes)


def off(found_i3, known_i3):
    """Return degrees between unit vectors."""
    return np.degrees(np.arccos(np.clip(np.sum(found_i3 * known_i3, axis=1), -1.0, 1.0)))


def find(photographs_ihw, **options):
    """Return directions and the report, of photographs as 8-bit sRGB in memory."""
    report = cr.Report()
    up_i3 = np.tile([0.0, 0.0, 1.0], (len(photographs_ihw), 1))
    stack = cr.LightStack(srgb_codes(photographs_ihw), up_i3, 255.0, "srgb")
    return cr.find_lights(stack, report=report, **options).directions_i3, report


@pytest.mark.parametrize(
    ("spheres", "how"),
    [
        ([BALL], {}),
        ([BALL], {"noise": 0.03}),
        ([BALL], {"exposure": 0.15}),
        ([BALL], {"shade": 0.1}),
        ([BALL], {"windows": ((0.3, 0.5, 0.81), (-0.6, 0.1, 0.79))}),
        ([BALL], {"texture": 0.0, "diffuse": 0.15}),
        ([(55.2, 60.7, 30.6)], {}),
        ([(95.1, 56.3, 50.4)], {"blur": 1.2}),
    ],
)
def test_a_glossy_sphere_tells_lights_to_half_a_degree(spheres, how):
    lights_i3 = lamps(6, 1)
    found_i3, report = find(photograph_spheres(lights_i3, SIZE, spheres, **how))
    np.testing.assert_allclose(report.facts["spheres"][0], spheres[0], atol=0.25)
    assert off(found_i3, lights_i3).max() < 0.5
    # The normal of the highlight is half way: whoever takes it for the light is far off.
    half_i3 = found_i3 + np.array([0.0, 0.0, 1.0])
    half_i3 /= np.linalg.norm(half_i3, axis=1, keepdims=True)
    assert np.median(off(half_i3, lights_i3)) > 10.0


def test_a_photograph_hard_to_read_tells_lights_to_three_degrees():
    lights_i3 = lamps(9, 1)
    photographs_ihw = photograph_spheres(
        lights_i3,
        (150, 210),
        [(160.4, 60.7, 33.3)],
        texture=0.5,
        table=0.4,
        windows=((0.3, 0.5, 0.81), (-0.6, 0.1, 0.79)),
        shade=0.25,
        exposure=0.35,
        noise=0.01,
        blur=1.0,
        diffuse=0.15,
    )
    found_i3, _ = find(photographs_ihw)
    assert off(found_i3, lights_i3).max() < 3.0
    assert np.median(off(found_i3, lights_i3)) < 2.0


def test_lights_behind_the_horizon_and_photographs_without_any():
    lights_i3 = np.array([[0.9, 0.0, -0.436], [0.0, 0.6, 0.8], [-0.5, -0.5, 0.707], [0.3, 0.2, 0.93], [0.0, -0.8, 0.6]])
    lights_i3 /= np.linalg.norm(lights_i3, axis=1, keepdims=True)
    photographs_ihw = photograph_spheres(lights_i3, SIZE, [BALL])
    photographs_ihw[3] = 0.03
    found_i3, report = find(photographs_ihw)
    assert not found_i3[3].any()
    kept = [0, 1, 2, 4]
    assert off(found_i3[kept], lights_i3[kept]).max() < 0.5
    assert any("no highlight in image0003: left out" in note for note in report.notes)
    assert any("1 light is below the horizon" in note for note in report.notes)


def test_several_lamps_are_told_of():
    lights_i3 = lamps(6, 4, least=0.4)
    photographs_ihw = photograph_spheres(lights_i3, SIZE, [BALL])
    photographs_ihw[2] = np.maximum(photographs_ihw[2], photographs_ihw[4])
    _, report = find(photographs_ihw)
    assert any("more than one bright highlight in image0002" in note for note in report.notes)
    assert report.facts["lights"][2]["confidence"] < 0.5 < report.facts["lights"][1]["confidence"]
    assert "second highlight" in report.facts["lights"][2]["doubt"]
    assert any("not to be trusted (second highlight" in note and "image0002" in note for note in report.notes)
    assert report.facts["lights"][1]["doubt"] is None


def test_two_spheres_are_found_and_agree():
    lights_i3, spheres = lamps(6, 2), [(45.4, 50.7, 33.3), (140.3, 70.2, 36.1)]
    photographs_ihw = photograph_spheres(lights_i3, (112, 190), spheres)
    found_i3, report = find(photographs_ihw, count=2)
    held = sorted(report.facts["spheres"])
    np.testing.assert_allclose(held, spheres, atol=0.25)
    assert off(found_i3, lights_i3).max() < 0.5
    assert max(row["apart"] for row in report.facts["lights"]) < 0.6
    given_i3, _ = find(photographs_ihw, spheres=[(46.0, 50.0, 33.0), (140.0, 71.0, 36.0)])
    np.testing.assert_allclose(given_i3, found_i3, atol=2e-3)


def test_a_near_camera_bends_rays():
    lights_i3 = lamps(5, 3, least=0.2)
    photographs_ihw = photograph_spheres(lights_i3, SIZE, [(105.3, 70.6, 35.0)], focal=250.0)
    found_i3, _ = find(photographs_ihw, focal=250.0)
    assert off(found_i3, lights_i3).max() < 0.7
    far_i3, _ = find(photographs_ihw)
    assert np.median(off(far_i3, lights_i3)) > 1.5


def test_a_matte_sphere_is_told_by_its_shading():
    lights_i3 = lamps(8, 5, least=0.3)
    photographs_ihw = photograph_spheres(lights_i3, SIZE, [BALL], matte=True, diffuse=0.7, room=0.0)
    found_i3, report = find(photographs_ihw, kind="matte")
    np.testing.assert_allclose(report.facts["spheres"][0], BALL, atol=1.0)
    assert off(found_i3, lights_i3).max() < 3.0


def body(size=48):
    """Return heights' normals, (h, w, 3), x right and y up, albedo and mask of a bulging body with bumps."""
    y_hw, x_hw = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    square_hw = 1 - (x_hw / 0.9) ** 2 - (y_hw / 0.75) ** 2
    heights_hw = 0.6 * np.sqrt(np.maximum(square_hw, 0)) + 0.06 * np.sin(6 * x_hw) * np.cos(5 * y_hw)
    step = 2 / (size - 1)
    down_hw, right_hw = np.gradient(heights_hw, step)
    normals = np.stack([-right_hw, down_hw, np.ones_like(heights_hw)], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return normals, 0.3 + 0.5 * np.random.default_rng(0).random((size, size)), square_hw > 0.08


def shade_body(lights_i3):
    normals, albedo_hw, mask_hw = body()
    return np.maximum(np.einsum("hwa,ia->ihw", normals, lights_i3), 0.0) * albedo_hw, normals, albedo_hw, mask_hw


def test_known_normals_tell_lights_with_and_without_albedo():
    lights_i3 = lamps(14, 6, least=0.4)
    samples_ihw, normals, albedo_hw, mask_hw = shade_body(lights_i3)
    bright_i = np.linspace(0.5, 1.5, 14)
    samples_ip = bright_i[:, None] * samples_ihw[:, mask_hw]
    for known, most in ((albedo_hw[mask_hw], 0.01), (None, 0.6)):
        found = lights_from_normals(samples_ip, normals[mask_hw], known)
        length_i = np.linalg.norm(found.lights_i3, axis=1)
        assert off(found.lights_i3 / length_i[:, None], lights_i3).max() < most
        np.testing.assert_allclose(length_i / length_i.mean(), bright_i, rtol=0.02)
    with pytest.raises(cr.InputError, match="the normals do not tell"):
        lights_from_normals(samples_ip, np.tile([0.0, 0.0, 1.0], (samples_ip.shape[1], 1)))


def test_lamps_and_surface_are_found_together():
    lights_i3 = make_pattern("uniform", 24)
    lights_i3 = lights_i3[lights_i3[:, 2] > 0.4]
    samples_ihw, _, _, mask_hw = shade_body(lights_i3)
    found = lights_from_surface(samples_ihw, mask_hw)
    unit_i3 = found.lights_i3 / np.linalg.norm(found.lights_i3, axis=1, keepdims=True)
    assert off(unit_i3, lights_i3).max() < 2.0
    assert found.uneven < 0.02
    # The bas-relief: other lamps and normals make the very same photographs, unless lamps are equal.
    uneven = lights_from_surface(np.linspace(0.4, 1.6, len(lights_i3))[:, None, None] * samples_ihw, mask_hw)
    assert uneven.uneven > 0.1
    with pytest.raises(cr.InputError, match="at least 6 photographs"):
        lights_from_surface(samples_ihw[:5], mask_hw)


@pytest.mark.parametrize(("name", "most"), [("cat", 4.5)])
def test_an_object_tells_the_lights_of_real_photographs(real_data, name, most):
    scipy_io = pytest.importorskip("scipy.io")
    folder = real_data / "stacks" / "diligent" / f"{name}PNG"
    normals = scipy_io.loadmat(folder / "Normal_gt.mat")["Normal_gt"]
    stack = cr.ingest(folder, report=cr.Report())
    pixels = np.flatnonzero(stack.mask_hw)[::20]
    grey_ip = stack.images_ihwc.mean(axis=3, dtype=np.float32).reshape(stack.n_light, -1)[:, pixels]
    found = lights_from_normals(grey_ip, normals.reshape(-1, 3)[pixels])
    unit_i3 = found.lights_i3 / np.linalg.norm(found.lights_i3, axis=1, keepdims=True)
    assert np.median(off(unit_i3, stack.directions_i3)) < most


def test_command_writes_lights_that_ingest_reads(tmp_path):
    lights_i3 = lamps(8, 7)
    write_photographs(tmp_path / "photos", photograph_spheres(lights_i3, SIZE, [BALL]))
    out, table, picture = (tmp_path / name for name in ("l.lp", "l.csv", "l.png"))
    words = ("find-lights", tmp_path / "photos", out, "--transfer", "srgb", "--csv", table, "--picture", picture)
    told = succeed(*words, "--json").json
    assert (told["n_light"], told["n_image"], told["files"]) == (8, 8, [str(out), str(table), str(picture)])
    held = read_light_file(out)
    assert held.names == tuple(f"photo{i:02d}.jpg" for i in range(8))
    assert off(held.directions_i3, lights_i3).max() < 0.5
    rows = list(csv.DictReader(table.open()))
    assert [row["image"] for row in rows] == list(held.names)
    np.testing.assert_allclose([float(row["z"]) for row in rows], held.directions_i3[:, 2], atol=1e-8)
    assert read_image(picture).shape == (*SIZE, 3)
    stack = cr.ingest(tmp_path / "photos", lights=out, transfer="srgb", report=cr.Report())
    np.testing.assert_allclose(stack.directions_i3, held.directions_i3, atol=1e-8)
    lines = succeed(*words[:3], "--transfer", "srgb", "--sphere", "82,56,40").out
    assert "8 of 8 photographs" in lines
    assert "photo07.jpg" in lines


def test_command_by_object(tmp_path):
    lights_i3 = lamps(9, 8, least=0.4)
    samples_ihw, normals, albedo_hw, mask_hw = shade_body(lights_i3)
    images = (np.where(mask_hw, samples_ihw, 0.0)[..., None]).astype(np.float32)
    cr.write_stack(tmp_path / "s.h5", cr.LightStack(images, lights_i3, 1.0))
    write_image(tmp_path / "n.exr", np.where(mask_hw[..., None], normals, 0).astype(np.float32))
    write_image(tmp_path / "a.exr", albedo_hw.astype(np.float32))
    words = ("find-lights", tmp_path / "s.h5", tmp_path / "l.lp", "--by", "object", "--normals", tmp_path / "n.exr")
    told = succeed(*words, "--albedo", tmp_path / "a.exr", "--json").json
    assert told["off_known"]["most"] < 0.1
    assert "off the stack's own" in succeed(*words).out
    write_image(tmp_path / "m.png", (255 * mask_hw).astype(np.uint8))
    together = call(*words[:5], "--mask", tmp_path / "m.png", "--json")
    assert (together.code, together.err) == (0, "")
    assert together.json["off_known"]["median"] < 3.0
    assert any("bas-relief" in note for note in together.json["notes"])


@pytest.mark.parametrize("band", [1, 8 << 20])
def test_parts_of_photographs_are_means_of_blocks(tmp_path, monkeypatch, band):
    codes = np.random.default_rng(1).integers(0, 255, (4, 23, 31, 3)).astype(np.uint8)
    cr.write_stack(tmp_path / "s.h5", cr.LightStack(codes, lamps(4, 1), 255.0))
    (tmp_path / "photos").mkdir()
    for i, each in enumerate(codes):
        write_image(tmp_path / "photos" / f"{i}.png", each)
    monkeypatch.setattr(light_frames, "BAND_BYTES", band)
    grey = codes[:, 2:19, 3:30].astype(float).mean(axis=3) / 255.0
    expected = [
        [part.mean(axis=(1, 2)) for part in np.split(rows, range(5, 27, 5), axis=2)]
        for rows in np.split(grey, range(5, 17, 5), axis=1)
    ]
    for source in (tmp_path / "s.h5", tmp_path / "photos"):
        with light_frames.lend_frames(source, "linear", cr.Report()) as frames:
            found = frames.take((3, 2, 27, 17), 5, [2, 0])
        np.testing.assert_allclose(found, np.array(expected).transpose(2, 0, 1)[[2, 0]], atol=1e-6)


def test_what_cannot_be_found_is_refused(tmp_path):
    rng = np.random.default_rng(0)
    write_photographs(tmp_path / "plain", rng.random((4, 40, 50)) * 0.2)
    (tmp_path / "empty").mkdir()
    write_photographs(tmp_path / "lone", np.full((2, 40, 50), 0.1))
    clouds = [ndimage.gaussian_filter(each, 2.0) for each in rng.standard_normal((6, 60, 70))]
    write_photographs(tmp_path / "clouds", np.clip(0.3 + np.array(clouds), 0.0, 1.0))
    before = contents(tmp_path)
    out = tmp_path / "l.lp"
    for words, message in (
        ([tmp_path / "plain", out], "no sphere is found"),
        ([tmp_path / "plain", out, "--sphere", "500,500,20"], "outside the photographs"),
        ([tmp_path / "lone", out, "--sphere", "20,20,12"], "no highlight is found"),
        ([tmp_path / "clouds", out, "--sphere", "35,30,20"], "no highlight is found"),
        ([tmp_path / "clouds", out, "--sphere", "35,30,20", "--kind", "matte"], "not shaded as a matte sphere"),
        ([tmp_path / "empty", out], "no images"),
        ([tmp_path / "plain", tmp_path / "l.txt"], "lights go to a .lp"),
        ([tmp_path / "plain", out, "--sphere", "20,20,12", "--focal", "-3"], "focal must be"),
        ([tmp_path / "plain", out, "--normals", tmp_path / "n.exr"], "are of the object"),
        ([tmp_path / "plain", out, "--by", "object", "--sphere", "1,2,3"], "for lights by spheres"),
        ([tmp_path / "nowhere", out], "nowhere"),
    ):
        ended = call("find-lights", *words)
        assert (ended.code, ended.out) == (2, ""), words
        assert message in ended.err.splitlines()[-1]
        assert contents(tmp_path) == before


def test_a_jpeg_goes_through_memory_not_a_pipe_that_may_fill(tmp_path, monkeypatch):
    def refuse(part):
        raise AssertionError("a pipe")

    monkeypatch.setattr(image_sink, "_pipe", refuse)
    write_image(tmp_path / "a.jpg", np.random.default_rng(0).integers(0, 255, (300, 420, 3)).astype(np.uint8))
    assert read_image(tmp_path / "a.jpg").shape == (300, 420, 3)


def test_most_photographs_may_be_of_one_lamp():
    """Its highlight does not move; those of the others are found where it is missing."""
    lights_i3 = lamps(6, 1)[[0, 0, 0, 0, 1, 2]]
    found_i3, report = find(photograph_spheres(lights_i3, SIZE, [BALL]), spheres=[BALL])
    assert off(found_i3, lights_i3)[4:].max() < 0.5
    assert any("no highlight in image0000" in note for note in report.notes)


def test_few_photographs_are_warned_of():
    _, report = find(photograph_spheres(lamps(6, 1)[:2], SIZE, [BALL]))
    assert any("hardly tell a sphere" in note for note in report.notes)


def test_a_sphere_beside_the_picture_and_one_that_is_blown_out_are_told_of():
    photographs_ihw = photograph_spheres(lamps(5, 1), SIZE, [BALL])
    x, _, radius = BALL
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        with pytest.raises(cr.InputError, match="no highlight"):
            find(photographs_ihw[:, :, : int(x - radius) - 2], spheres=[BALL])
        report = cr.Report()
        codes_ihwc = np.full((5, *SIZE, 1), 255, np.uint8)
        stack = cr.LightStack(codes_ihwc, np.tile([0.0, 0.0, 1.0], (5, 1)), 255.0, "srgb")
        with pytest.raises(cr.InputError, match="no highlight"):
            cr.find_lights(stack, spheres=[BALL], report=report)
    assert any("over-exposed in most photographs" in note for note in report.notes)
