"""FLIP and CIEDE2000 beside PSNR, against images that are made, shown and compared here."""

import importlib.util
import os

import numpy as np
import pytest

import clrelight as cr
from clrelight.dataset import LightStack
from clrelight.jobs import perceived
from clrelight.perception import ciede2000, colour_difference, display_of
from clrelight.sampling import make_pattern
from clrelight.store import write_stack
from tests.commands import call, succeed
from tests.reference.basis import real_harmonics
from tests.reference.psnr import decode, encode
from tests.stacks import make_samples

needs_flip = pytest.mark.skipif(
    importlib.util.find_spec("flip_evaluator") is None, reason="FLIP needs flip-evaluator (extra flip)"
)

# Sharma, Wu and Dalal 2005, table 1.
SHARMA = [
    ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
    ((50.0, 3.1571, -77.2803), (50.0, 0.0, -82.7485), 2.8615),
    ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0000),
    ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
    ((50.0, 2.4900, -0.0010), (50.0, -2.4900, 0.0009), 7.1792),
    ((50.0, 2.4900, -0.0010), (50.0, -2.4900, 0.0011), 7.2195),
    ((50.0, -0.0010, 2.4900), (50.0, 0.0011, -2.4900), 4.7461),
    ((50.0, 2.5000, 0.0), (50.0, 0.0, -2.5000), 4.3065),
    ((50.0, 2.5000, 0.0), (73.0, 25.0, -18.0), 27.1492),
    ((50.0, 2.5000, 0.0), (61.0, -5.0, 29.0), 22.8977),
    ((50.0, 2.5000, 0.0), (56.0, -27.0, -3.0), 31.9030),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((63.0109, -31.0961, -5.8663), (62.8187, -29.7946, -4.0864), 1.2630),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((90.8027, -2.0831, 1.4410), (91.1528, -1.6435, 0.0447), 1.4441),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]


def test_colour_differences_are_the_published_ones():
    one, other, expected = (np.array(column) for column in zip(*SHARMA, strict=True))
    np.testing.assert_allclose(ciede2000(one, other), expected, atol=5e-5)
    np.testing.assert_allclose(ciede2000(other, one), expected, atol=5e-5)


def test_colour_differences_of_pictures_use_the_srgb_curve():
    black, white, grey = np.zeros((1, 3)), np.ones((1, 3)), np.full((1, 3), 119 / 255)
    assert colour_difference(black, white) == pytest.approx(100.0, abs=0.01)
    # L* of sRGB 119 is 50.03; the weight of lightness is least there.
    assert colour_difference(grey, grey + 1 / 255) == pytest.approx(0.405, abs=0.01)


def test_what_is_shown_is_srgb_at_the_peak():
    values = np.array([-0.5, 0.0, 0.001, 0.2, 1.0, 3.0]).reshape(1, -1, 1)
    expected = encode(np.clip(values, 0, 1))
    np.testing.assert_allclose(display_of(values, "linear"), np.repeat(expected, 3, axis=2), atol=1e-7)
    np.testing.assert_allclose(display_of(values, "srgb")[..., 1], np.clip(values[..., 0], 0, 1), atol=1e-7)


def view(transfer="srgb", channel=3, masked=True, size=(24, 31), n_light=45):
    directions = make_pattern("uniform", n_light)
    samples = make_samples(directions, (*size, channel)).reshape(n_light, *size, channel)
    dtype = np.uint8 if transfer == "srgb" else np.float32
    images = np.rint(255 * samples).astype(np.uint8) if dtype == np.uint8 else np.float32(2.0 * samples)
    mask = np.ones(size, bool)
    mask[:5, 7:] = not masked
    return LightStack(images, directions, 255.0 if dtype == np.uint8 else 2.0, transfer, mask_hw=mask)


def expected_figures(stack, fitted, lights):
    """FLIP and CIEDE2000 of relit and given images, pixel by pixel, in float64."""
    import flip_evaluator

    basis = real_harmonics(stack.directions_i3[lights], fitted.degree)
    relit = encode(np.clip(np.einsum("ik,khwc->ihwc", basis, np.float64(fitted.coeffs_khwc)), 0, 1))
    given = np.clip(np.float64(stack.images_ihwc)[lights] / stack.peak, 0, 1)
    given = given if stack.transfer == "srgb" else encode(given)
    mask, flips, colours = stack.mask_hw, [], []
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])

    def lab(shown):
        ratio = decode(shown) @ xyz.T / xyz.sum(axis=1)
        f = np.where(ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16) / 116)
        return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)

    for a, b in zip(given, relit, strict=True):
        a, b = (np.repeat(np.where(mask[..., None], v, 0), 3 // v.shape[2], axis=2) for v in (a, b))
        flip = flip_evaluator.evaluate(np.float32(a), np.float32(b), "LDR", applyMagma=False)[0][..., 0]
        flips.append(flip[mask].mean())
        colours.append(ciede2000(lab(a), lab(b))[mask].mean())
    return np.array(flips), np.array(colours)


@needs_flip
@pytest.mark.parametrize(("transfer", "channel"), [("srgb", 3), ("linear", 3), ("srgb", 1)])
def test_the_command_measures_what_the_eye_sees(tmp_path, transfer, channel):
    stack = view(transfer, channel)
    write_stack(tmp_path / "s.h5", stack)
    succeed("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--holdout", 3, "--degree", 3, "--json")
    fitted = cr.read_fit(tmp_path / "f.h5")
    told = succeed("psnr", tmp_path / "f.h5", tmp_path / "s.h5", "--perceptual", "--json").json["psnr"]
    for name, of_all in (("fitted", np.arange(45)[np.arange(45) % 3 != 2]), ("holdout", np.arange(2, 45, 3))):
        lights = of_all[np.linspace(0, len(of_all) - 1, 8).round().astype(int)]
        for figure, of_lights in zip(("flip", "colour"), expected_figures(stack, fitted, lights), strict=True):
            error = np.sqrt(of_lights.var(ddof=1) / 8 * (1 - 8 / len(of_all)))
            assert told[f"{figure}_{name}"] == pytest.approx(of_lights.mean(), rel=1e-3)
            assert told[f"{figure}_error_{name}"] == pytest.approx(error, rel=5e-3)
        assert told[f"perceived_{name}"] == 8
    plain = succeed("psnr", tmp_path / "f.h5", tmp_path / "s.h5", "--json").json["psnr"]
    assert plain == {key: value for key, value in told.items() if key in plain}
    assert not any(key.startswith(("flip", "colour", "perceived")) for key in plain)
    lines = succeed("psnr", tmp_path / "f.h5", tmp_path / "s.h5", "--perceptual").out
    assert f"FLIP {told['flip_holdout']:.4f} ± {told['flip_error_holdout']:.4f}, CIEDE2000 " in lines


@needs_flip
def test_few_lights_are_all_looked_at_and_have_no_error(tmp_path):
    stack = view(n_light=7)
    found = cr.measure(cr.fit(stack, "spectrum", 2), stack, perceptual=True)
    assert (found["perceived_fitted"], found["flip_error_fitted"], found["colour_error_fitted"]) == (7, 0.0, 0.0)
    assert "flip_holdout" not in found


@needs_flip
def test_encoded_files_are_relit_part_by_part_and_pack_measures_alike(tmp_path, monkeypatch):
    stack = view(masked=False, size=(96, 64))
    write_stack(tmp_path / "s.h5", stack)
    asked = ("--method", "cls", "--degree", 3, "--holdout", 3, "--rate", 0.5)
    packed = succeed("pack", tmp_path / "s.h5", tmp_path / "p.h5", *asked, "--perceptual", "--json").json["psnr"]
    whole = cr.measure(tmp_path / "p.h5", stack, perceptual=True)
    assert packed["flip_holdout"] == pytest.approx(whole["flip_holdout"], rel=0.02)  # in code values, and of radiance
    monkeypatch.setattr("clrelight.jobs.measure.DEFAULT_MEMORY", 0)
    assert cr.measure(tmp_path / "p.h5", stack, perceptual=True)["flip_holdout"] == pytest.approx(
        packed["flip_holdout"], rel=1e-4
    )
    monkeypatch.setattr(perceived, "_MOST_PIXELS", 3000)
    monkeypatch.setattr("clrelight.jobs.measure_parts._WINDOW", 32)
    sampled = cr.measure(tmp_path / "p.h5", stack, perceptual=True)
    for figure in ("flip_holdout", "colour_holdout"):
        error = sampled[figure.replace("_", "_error_")]
        assert sampled[figure] != packed[figure]
        assert error > 0
        assert abs(sampled[figure] - packed[figure]) < 4 * error


def test_standard_errors_are_how_far_samples_lie():
    rng = np.random.default_rng(3)
    of_window, of_light = 1 + 0.3 * rng.standard_normal(40), 0.2 * rng.standard_normal(60)
    values_wi = of_window[:, None] + of_light
    means, errors = [], []
    for _ in range(3000):
        part = values_wi[rng.choice(40, 8, False)][:, rng.choice(60, 8, False)]
        mean, error = perceived._estimate(part * 100.0, np.full(8, 100.0), 60, 4000)
        means.append(mean)
        errors.append(error**2)
    assert np.mean(means) == pytest.approx(values_wi.mean(), abs=0.01)
    assert np.sqrt(np.mean(errors)) == pytest.approx(np.std(means), rel=0.05)


def test_without_the_package_or_colours_nothing_is_begun(tmp_path, monkeypatch):
    stack = view(channel=2, masked=False)
    write_stack(tmp_path / "two.h5", stack)
    write_stack(tmp_path / "s.h5", view())
    ended = call("pack", tmp_path / "two.h5", tmp_path / "p.h5", "--degree", 2, "--method", "cls", "--perceptual")
    assert ended.code == 2
    assert "the images have 2 channels" in ended.err
    monkeypatch.setattr("clrelight.perception.importlib.util.find_spec", lambda name: None)
    ended = call("pack", tmp_path / "s.h5", tmp_path / "p.h5", "--perceptual")
    assert ended.code == 2
    assert ended.err.endswith("perceptual figures need the package flip-evaluator: pip install 'clrelight[flip]'\n")
    assert sorted(os.listdir(tmp_path)) == ["s.h5", "two.h5"]
