"""What is told of an encoding is what it shows: PSNR is that of the pictures that are relit from it."""

from dataclasses import replace

import numpy as np
import pytest

import clrelight as cr
from clrelight.codec import decode_regions, decode_shown
from clrelight.conventions import linear_to_srgb
from clrelight.errors import InputError
from clrelight.experiment.portraits import LightPortrait
from clrelight.experiment.scenes import shrink_picture, survey_stack
from clrelight.jobs import measure as measuring
from clrelight.jobs.target import encode_to_quality
from clrelight.relight import to_display
from clrelight.store import write_stack
from tests.commands import succeed
from tests.styles import both_styles

SHAPE = (24, 32, 3)


@pytest.fixture(scope="module")
def stacks():
    """Photographs as displayed, with shadows and noise, and their radiance."""
    directions = cr.sampling.make_pattern("uniform", 30)
    y, x = np.mgrid[-1 : 1 : SHAPE[0] * 1j, -1 : 1 : SHAPE[1] * 1j]
    normals = np.stack([x, y, np.sqrt(np.maximum(2.1 - x * x - y * y, 0.05))], -1)
    shading = np.maximum(np.einsum("ic,hwc->ihw", directions, normals / np.linalg.norm(normals, axis=-1)[..., None]), 0)
    radiance = shading[..., None] * (0.4 + 0.3 * np.sin(12 * x + 5 * y)[..., None] * np.array([1.0, 0.5, -0.5]))
    radiance = np.clip(radiance + 0.02 * np.random.default_rng(0).standard_normal(radiance.shape), 0.0, 1.0)
    shown = np.rint(255.0 * linear_to_srgb(radiance)).astype(np.uint8)
    of_light = cr.LightStack(radiance.astype(np.float32), directions, 1.0, "linear")
    return cr.LightStack(shown, directions, 255.0, "srgb"), of_light


@pytest.fixture(scope="module")
def encoded(stacks):
    fitted = cr.fit(stacks[0], method="spectrum", degree=5)
    return cr.encode(fitted, "klt", rate=0.5)


def pictured(encoded, stack):
    """Return the pooled PSNR of relit pictures beside a stack, by NumPy alone."""
    relit = np.clip(cr.relight(encoded, stack.directions_i3).astype(np.float64), 0.0, 1.0)
    relit = linear_to_srgb(relit) if stack.transfer == "srgb" else relit
    return -10.0 * np.log10(np.mean((relit - stack.images_ihwc / stack.peak) ** 2))


def test_pictures_of_results_are_relit_ones(stacks, encoded):
    device, survey = cr.open_device(), survey_stack(stacks[0])
    shown_khwc, behind = decode_shown(encoded, device)
    assert behind == "srgb"
    drawn = LightPortrait(stacks[0], survey, device).draw(replace(cr.decode(encoded), coeffs_khwc=shown_khwc), behind)
    relit_hwc = cr.relight(encoded, stacks[0].directions_i3[survey.light])
    assert np.abs(drawn - shrink_picture(to_display(relit_hwc, "srgb")).astype(int)).max() <= 1


@both_styles
@pytest.mark.parametrize("of_light", [False, True])
def test_it_is_that_of_relit_pictures(device, stacks, encoded, of_light):
    stack = stacks[of_light]
    assert decode_regions(encoded).curve == "srgb"
    told = cr.measure(encoded, stack, device=device)["pooled_fitted"]
    assert told == pytest.approx(pictured(encoded, stack), abs=2e-3)
    # Coefficients of radiance hold no more than nearly that: the check tells them apart.
    assert abs(cr.measure(cr.decode(encoded), stack)["pooled_fitted"] - told) > 0.02


def test_parts_are_measured_alike(device, stacks, encoded, monkeypatch):
    monkeypatch.setattr(measuring, "DEFAULT_MEMORY", 1)
    told = cr.measure(encoded, stacks[0], device=device)["pooled_fitted"]
    assert told == pytest.approx(pictured(encoded, stacks[0]), abs=2e-3)


def test_a_target_is_that_of_relit_pictures(device, stacks):
    fitted = cr.fit(stacks[0], method="spectrum", degree=5)
    made, _, _ = encode_to_quality(fitted, stacks[0], 30.0, tolerance=0.1, device=device)
    found = replace(made, record=cr.dataset.FitRecord.of(fitted))
    assert 30.0 <= pictured(found, stacks[0]) < 30.15


def test_commands_tell_of_relit_pictures(stacks, tmp_path):
    stack = tmp_path / "stack.h5"
    write_stack(stack, stacks[0])
    succeed("fit", stack, tmp_path / "fit.h5", "--method", "spectrum", "--degree", "5", "--quiet")
    coded = tmp_path / "coded.h5"
    told = succeed("encode", tmp_path / "fit.h5", coded, "--rate", "0.5", "--stack", stack, "--json").json
    relit = pictured(coded, stacks[0])
    assert told["psnr"]["pooled_fitted"] == pytest.approx(relit, abs=2e-3)
    succeed("report", coded, "--stack", stack, "--out", tmp_path / "page")
    lights = np.genfromtxt(tmp_path / "page" / "lights.csv", delimiter=",", names=True, dtype=None, encoding=None)
    pooled = -10.0 * np.log10(np.mean(10.0 ** (-lights[lights.dtype.names[-1]] / 10.0)))
    assert pooled == pytest.approx(relit, abs=0.01)


def test_another_view_is_refused(encoded, stacks):
    wrong = replace(stacks[0], images_ihwc=np.ascontiguousarray(stacks[0].images_ihwc[:, :10]))
    with pytest.raises(
        InputError, match=r"the coefficients are of images \(24, 32, 3\) but the stack has \(10, 32, 3\)"
    ):
        cr.measure(encoded, wrong)
    fitted = cr.fit(stacks[0], method="spectrum", degree=5)
    with pytest.raises(
        InputError, match=r"the coefficients are of images \(24, 32, 3\) but the stack has \(10, 32, 3\)"
    ):
        cr.encode(fitted, "klt", rate=0.5, stack=wrong)
