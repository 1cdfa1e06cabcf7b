"""Measured reflectances: their files, good and bad, values at and between measurements, and colours."""

import numpy as np
import pytest

from clrelight.brdf.centred import Cosines
from clrelight.brdf.coefficients import Resolution, brdf_coefficients
from clrelight.brdf.colour import matching_functions, rgb_of_xyz, xyz_weights
from clrelight.brdf.measured import MeasuredBrdf, half_difference_places, read_brdf
from clrelight.errors import InputError

PAINTS = ("acryl_blue", "cayman", "garnet_red", "krylon_blue", "mystique")


def lines(rows=40, wavelengths=(450, 550, 650)):
    rng = np.random.default_rng(5)
    table = rng.random((rows, 4)) * [1.4, 0.0, 1.4, 3.1]
    values = np.exp(-3 * rng.random((rows, len(wavelengths))))
    text = ["# a paint", str(len(wavelengths)), " ".join(map(str, wavelengths))]
    return text + [" ".join(f"{v:.6f}" for v in [*a, *b]) for a, b in zip(table, values, strict=True)]


def written(tmp_path, text):
    path = tmp_path / "paint.brdf"
    path.write_text("\n".join(text) + "\n")
    return path


def cosines_of(angles_j4):
    light, view = (
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
        for t, p in (angles_j4[:, :2].T, angles_j4[:, 2:].T)
    )
    return Cosines(light[:, 2], view[:, 2], np.sum(light * view, axis=1))


def test_matching_functions_are_the_observers():
    """Peaks and sums of the CIE 1931 tables, 380 to 780 nm by 5."""
    wavelengths = np.arange(380.0, 781.0, 5.0)
    rows = matching_functions(wavelengths)
    np.testing.assert_allclose(rows.max(axis=1), (1.0622, 1.0, 1.7826), rtol=0.02)
    np.testing.assert_allclose(rows.sum(axis=1), (21.3714, 21.3711, 21.3715), rtol=0.01)
    assert wavelengths[rows[1].argmax()] == 555.0


def test_white_is_white_and_a_red_is_red():
    wavelengths = np.arange(400.0, 701.0, 10.0)
    weights = xyz_weights(wavelengths)
    np.testing.assert_allclose(rgb_of_xyz(weights.sum(axis=1)), 1.0, atol=1e-12)
    red = rgb_of_xyz(weights @ (wavelengths > 600).astype(float))
    assert red[0] > 0.7
    assert red[1:].max() < 0.1


def test_measurements_are_met(tmp_path):
    samples = read_brdf(written(tmp_path, lines()))
    brdf = MeasuredBrdf(samples)
    got = brdf.interpolate(cosines_of(samples.angles_j4))
    np.testing.assert_allclose(got, rgb_of_xyz(samples.xyz_jc), rtol=1e-5, atol=1e-9)
    swapped = brdf.interpolate(cosines_of(samples.angles_j4[:, [2, 3, 0, 1]]))
    np.testing.assert_allclose(swapped, got, rtol=1e-5, atol=1e-9)  # reciprocal


def test_places_are_half_and_difference_angles():
    """The mirror direction has theta_h = 0; a light at the view theta_d = 0."""
    mirrored = cosines_of(np.array([[0.7, 0.0, 0.7, np.pi]]))
    np.testing.assert_allclose(half_difference_places(mirrored)[0, 0], 0.0, atol=1e-7)
    np.testing.assert_allclose(np.hypot(*half_difference_places(mirrored)[0, 1:]), 0.7, atol=1e-7)
    same = cosines_of(np.array([[0.7, 0.4, 0.7, 0.4]]))
    np.testing.assert_allclose(half_difference_places(same)[0], (0.7, 0.0, 0.0), atol=1e-7)


def test_nothing_from_below(tmp_path):
    brdf = MeasuredBrdf(read_brdf(written(tmp_path, lines())))
    theta_o = np.array([0.0, 0.5, np.pi])
    assert brdf.evaluate(np.array([3.0]), theta_o, np.array([np.pi])).max() == 0.0
    assert (brdf.evaluate(np.array([0.2]), theta_o[:2], np.array([0.0])) > 0).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: [], "must begin with the number of wavelengths"),
        (lambda text: ["three", *text[2:]], "must begin with the number of wavelengths"),
        (lambda text: ["-3", *text[2:]], "must begin with the number of wavelengths"),
        (lambda text: [*text[:2], "450 550", *text[3:]], "wavelengths are announced"),
        (lambda text: [*text[:2], "450 650 550", *text[3:]], "must ascend"),
        (lambda text: [*text[:2], "450 inf nan", *text[3:]], "must ascend"),
        (lambda text: [*text[:5], text[5] + " 0.5", *text[6:]], "line 6: expected 4 angles and 3 values, got 8"),
        (lambda text: [*text[:5], text[5] + " what", *text[6:]], "line 6: expected numbers"),
        (lambda text: text[:9], "6 pairs of directions, at least 16"),
        (lambda text: [*text, "0.5 0 0.5 1 0.1 -0.1 0.1"], "values not negative"),
        (lambda text: [*text, "0.5 0 0.5 1 0.1 nan 0.1"], "finite"),
        (lambda text: [*text, "50 0 50 120 0.1 0.1 0.1"], "polar angles must be radians"),
        (lambda text: [*text, "0.5 0 0.5 120 0.1 0.1 0.1"], "azimuths must be radians"),
    ],
)
def test_bad_files_are_refused(tmp_path, change, said):
    with pytest.raises(InputError, match=said) as refused:
        read_brdf(written(tmp_path, change(lines())))
    assert "\n" not in str(refused.value)


def test_binary_files_are_refused(tmp_path):
    path = tmp_path / "paint.brdf"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="no text file"):
        read_brdf(path)


@pytest.mark.parametrize("paint", PAINTS)
def test_paints(real_data, paint):
    """Mirror-like paints are far from P = 5: what counts is the grazing peak, which one or two measurements hold."""
    brdf = MeasuredBrdf(read_brdf(real_data / "brdf" / f"{paint}.brdf"))
    assert brdf.samples.spectra_jw.shape == (1439, 31)
    shares = brdf_coefficients(brdf, 30, 5, Resolution(64, 40, 40)).shares()[-1].mean(axis=1)
    assert (np.diff(shares) > 0).all()
    assert 0.2 < shares[-1] < 0.85
    theta = np.array([0.6])
    rgb = brdf.evaluate(np.zeros(1), 2 * theta, np.zeros(1))[0]
    away = brdf.evaluate(np.array([0.8]), 2 * theta, np.array([np.pi / 2]))[0]
    assert rgb.sum() > away.sum()
