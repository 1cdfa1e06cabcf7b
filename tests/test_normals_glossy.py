"""Normals of glossy surfaces: reflectance is found with them, from where they are seen, and by which curve."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.sampling import make_pattern
from clrelight.variation import maps
from clrelight.variation.reflectance import Law, fit_law, view_vectors
from clrelight.variation.reflectance_kernel import LawSolver
from tests.commands import call, succeed
from tests.styles import every_width
from tests.test_normals import ALBEDO, angles, dome

SIZE = 40


def looks(field, size=SIZE):
    """Return unit vectors to a camera whose picture takes `field` degrees across, (size, size, 3)."""
    slope = np.tan(np.radians(field / 2)) / (size / 2)
    x_w, y_h = np.arange(size) - (size - 1) / 2, (size - 1) / 2 - np.arange(size)
    x_hw, y_hw = np.meshgrid(x_w, y_h)
    view_hw3 = np.stack([-slope * x_hw, -slope * y_hw, np.ones_like(x_hw)], axis=2)
    return view_hw3 / np.linalg.norm(view_hw3, axis=2, keepdims=True)


def shine(normals_hw3, directions_i3, view_hw3, roughness=0.45):
    """Return Cook-Torrance's gloss with the distribution of Trowbridge and Reitz and Smith's shadowing, times n . l."""
    half_ihw3 = directions_i3[:, None, None] + view_hw3
    half_ihw3 /= np.linalg.norm(half_ihw3, axis=3, keepdims=True)
    cosine_ihw = np.maximum(np.einsum("ia,hwa->ihw", directions_i3, normals_hw3), 0.0)
    facing_hw = np.maximum(np.sum(normals_hw3 * view_hw3, axis=2), 1e-3)
    tilt_ihw = np.einsum("ihwa,hwa->ihw", half_ihw3, normals_hw3)
    square = roughness**2
    spread_ihw = square / (np.pi * (tilt_ihw**2 * (square - 1) + 1) ** 2)

    def shadowing(cosine):
        return 2 / (1 + np.sqrt(1 + square * (1 / np.maximum(cosine, 1e-6) ** 2 - 1)))

    return spread_ihw * shadowing(cosine_ihw) * shadowing(facing_hw) / (4 * facing_hw) * (cosine_ihw > 0)


def glossy_stack(*, gloss=0.3, field=0.0, matte=1.0, lights=49, bend=False, codes=False, mask_hw=None):
    normals_hw3 = dome(SIZE)[0]
    directions_i3 = make_pattern("uniform", lights)
    cosine_ihw = np.maximum(np.einsum("ia,hwa->ihw", directions_i3, normals_hw3), 0.0)
    if bend:
        cosine_ihw = 0.3 * cosine_ihw + 0.7 * cosine_ihw**2
    shine_ihw = shine(normals_hw3, directions_i3, looks(field))
    images = matte * ALBEDO * cosine_ihw[..., None] + gloss * shine_ihw[..., None]
    if not codes:
        return cr.LightStack(images.astype(np.float32), directions_i3, 1.0, mask_hw=mask_hw)
    images = images.clip(0, 1)
    encoded = np.where(images <= 0.0031308, 12.92 * images, 1.055 * images ** (1 / 2.4) - 0.055)
    return cr.LightStack(np.rint(255 * encoded).astype(np.uint8), directions_i3, 255.0)


def errors(stack, **options):
    report = cr.Report()
    found = cr.normals(stack, report=report, **options)
    return angles(found.normals_hw3, dome(SIZE)[0]), report, found


@pytest.mark.parametrize("field", [0.0, 40.0])
def test_gloss_is_found_with_the_normal(field):
    stack = glossy_stack(field=field)
    robust, report, found = errors(stack)
    quick, _, _ = errors(stack, method="quick")
    plain, _, _ = errors(stack, method="least-squares")
    assert found.method == report.facts["method"] == "robust"
    assert "gloss" in report.facts["law"]
    assert abs(found.found.law.field - field) < 8
    assert np.median(robust) < 0.6
    assert robust.mean() < 0.75 * quick.mean()
    assert robust.mean() < 0.2 * plain.mean()
    inside = np.s_[4:-4, 4:-4]
    np.testing.assert_allclose(np.median(found.albedo_hwc[inside], axis=(0, 1)), ALBEDO, atol=0.06)


def test_metal():
    """Without any matte reflectance."""
    robust, _, found = errors(glossy_stack(matte=0.0))
    assert np.median(robust) < 1.0
    assert np.median(found.albedo_hwc) < 0.3 * np.median(errors(glossy_stack())[2].albedo_hwc)


def test_a_known_camera_is_taken():
    asked, report, found = errors(glossy_stack(field=40.0), field=40)
    assert found.found.law.field == 40
    assert "over 40°" in report.facts["law"]
    assert np.median(asked) < np.median(errors(glossy_stack(field=40.0), field=0)[0])


@pytest.mark.parametrize(("bend", "matte"), [(False, (True, False, False)), (True, (True, True, False))])
def test_terms_are_those_that_predict(bend, matte):
    robust, _, found = errors(glossy_stack(gloss=0.0, bend=bend))
    assert found.found.law.matte == matte
    assert robust.mean() < 0.2


def test_curve_from_the_samples():
    stack = glossy_stack(codes=True)
    wrong, told, _ = errors(stack)
    assert "follow srgb better than linear" in told.notes[0]
    right, report, found = errors(stack, transfer="auto")
    assert found.found.transfer == report.facts["transfer"] == "srgb"
    assert report.facts["curves"]["srgb"] < report.facts["curves"]["linear"]
    np.testing.assert_array_equal(errors(stack, transfer="srgb")[2].normals_hw3, found.normals_hw3)
    assert right.mean() < 0.3 * wrong.mean()
    assert errors(glossy_stack(), transfer="auto")[2].found.transfer == "linear"


def test_auto_says_when_gloss_is_left_out(monkeypatch, tmp_path):
    few = glossy_stack(lights=9)
    report = cr.Report()
    assert cr.normals(few, report=report).method == "robust"
    assert "9 lights do not tell gloss" in report.notes[0]
    monkeypatch.setattr(maps, "MOST_ROBUST", 1000)
    report = cr.Report()
    assert cr.normals(glossy_stack(), report=report).method == "quick"
    assert "large stack" in report.notes[0]
    assert cr.normals(glossy_stack(), method="robust", report=cr.Report()).method == "robust"


def test_three_lights_are_solved_as_they_are():
    directions_i3 = np.array([[0.5, 0, 0.8], [-0.3, 0.4, 0.8], [-0.2, -0.4, 0.9]])
    directions_i3 /= np.linalg.norm(directions_i3, axis=1, keepdims=True)
    normals_hw3 = dome(SIZE)[0] * [0.4, 0.4, 1]
    normals_hw3 /= np.linalg.norm(normals_hw3, axis=2, keepdims=True)
    images = np.einsum("ia,hwa->ihw", directions_i3, normals_hw3)[..., None] * ALBEDO
    found = cr.normals(cr.LightStack(images.astype(np.float32), directions_i3, 1.0), report=cr.Report())
    assert angles(found.normals_hw3, normals_hw3).max() < 0.1
    np.testing.assert_allclose(found.albedo_hwc, np.broadcast_to(ALBEDO, found.albedo_hwc.shape), rtol=0.01)


def test_command_names_law_and_curve(tmp_path):
    cr.write_stack(tmp_path / "s.h5", glossy_stack(codes=True, field=40.0))
    out = succeed("normals", tmp_path / "s.h5", tmp_path / "n.exr", "--transfer", "auto").out
    assert "law         Lambert" in out
    assert "+ gloss, seen over" in out
    assert "transfer    srgb (errors of lights left out: linear" in out
    told = call("normals", tmp_path / "s.h5", tmp_path / "n.exr", "--field", "0", "--json").json
    assert told["law"].endswith("seen from afar")
    assert told["transfer"] == "linear"
    assert "srgb" in told["notes"][0]


@every_width
@pytest.mark.parametrize("count", [16, 112])
@pytest.mark.parametrize(
    ("lights", "law"),
    [
        (13, Law()),
        (49, Law((True, True, True), True, 40.0)),
        (70, Law((True, False, True), True)),
        (5, Law((True, True, False), False)),
    ],
)
def test_kernel_is_the_numpy_form(device, count, lights, law):
    stack = glossy_stack(lights=lights, field=law.field, gloss=0.2)
    samples_cip = stack.images_ihwc.reshape(lights, -1, 3)[:, 100 : 100 + count].transpose(2, 0, 1).copy()
    samples_cip[:, 1] += 0.02
    samples_cip[:, :, 3] = 0.0
    rows_p, columns_p = np.divmod(np.arange(100, 100 + count), SIZE)
    view_p3 = view_vectors(rows_p, columns_p, (SIZE, SIZE), law.field)
    fitted_i = np.arange(lights) % 4 != 1
    held = fit_law(samples_cip, stack.directions_i3, view_p3, law, fitted_i=fitted_i, most=0.9, floor=0.02)
    solver = LawSolver(device, stack.directions_i3, law, fitted_i=fitted_i, floor=0.02)
    found = solver(samples_cip, np.ascontiguousarray(view_p3.T), 0.9)
    seen = np.arange(count) != 3
    apart = angles(found.found.normals_p3, held.found.normals_p3)[seen]
    assert not found.found.normals_p3[3].any()
    assert found.found.confidence_p[3] == 0
    assert np.median(apart) < 0.05
    assert np.mean(apart < 0.5) >= 0.85
    close = np.flatnonzero(seen)[apart < 0.05]
    np.testing.assert_allclose(found.found.albedo_pc[close], held.found.albedo_pc[close], rtol=0.02, atol=0.002)
    np.testing.assert_allclose(found.found.confidence_p[close], held.found.confidence_p[close], atol=0.01)
    np.testing.assert_allclose([found.error, found.count], [held.error, held.count], rtol=0.1, atol=0.5)


def test_numpy_form_without_a_device():
    mask_hw = np.zeros((SIZE, SIZE), bool)
    mask_hw[10:14, 10:16] = True
    held = maps.map_normals(glossy_stack(mask_hw=mask_hw), "robust")
    assert np.median(angles(held.normals_hw3, dome(SIZE)[0])[mask_hw]) < 0.5
    assert not held.normals_hw3[~mask_hw].any()
