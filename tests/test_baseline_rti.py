import io
import math
import sys

import numpy as np
import pytest

from benchmarks.jpeg_planes import compress_planes
from benchmarks.rti_baseline import measure_rti
from benchmarks.rti_tools import BASES, fit_rti, hsh_basis, ptm_basis
from clrelight.dataset import LightStack, split_lights
from clrelight.errors import InputError

pytest.importorskip("PIL")


def lights(count, seed=0):
    rng = np.random.default_rng(seed)
    directions = rng.standard_normal((count, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 0.2
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def stack_of(basis_ik, directions, shape=(20, 24, 3), mask=None, peak=1.0, noise=0.0):
    """Images that are exactly a basis times smooth planes, within 0..1."""
    rng = np.random.default_rng(1)
    h, w, c = np.indices(shape)
    planes = [np.sin(h / 9 + w / 11 + rng.uniform(0, 6) + 0.3 * c) for _ in range(basis_ik.shape[1])]
    images = np.tensordot(basis_ik, np.stack(planes), axes=1)
    images = 0.5 + 0.4 * images / np.abs(images).max() + noise * rng.standard_normal(images.shape)
    return LightStack((images * peak).clip(0, peak).astype(np.float32), directions, peak=peak, mask_hw=mask)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_hemispherical_harmonics_are_orthonormal(degree):
    z, weight = np.polynomial.legendre.leggauss(16)
    z, weight = (z + 1) / 2, weight / 2
    azimuth = np.arange(16) * 2 * np.pi / 16
    zz, aa = (a.ravel() for a in np.meshgrid(z, azimuth))
    sine = np.sqrt(1 - zz**2)
    basis = hsh_basis(np.stack([sine * np.cos(aa), sine * np.sin(aa), zz], axis=1), degree)
    weights = np.tile(weight, 16) * 2 * np.pi / 16
    np.testing.assert_allclose((basis * weights[:, None]).T @ basis, np.eye((degree + 1) ** 2), atol=1e-12)


def test_polynomial_terms():
    np.testing.assert_allclose(ptm_basis(np.array([[0.6, 0.0, 0.8]])), [[1, 0.6, 0, 0.36, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(ptm_basis(np.array([[0.2, -0.5, 0.8]])), [[1, 0.2, -0.5, 0.04, 0.25, -0.1]], atol=1e-15)


@pytest.mark.parametrize("peak", [1.0, 255.0])
@pytest.mark.parametrize("name", ["ptm", "hsh4", "hsh9", "hsh16"])
def test_a_stack_of_the_basis_itself_is_met_at_unseen_lights(name, peak):
    directions = lights(60)
    basis = ptm_basis(directions) if name == "ptm" else hsh_basis(directions, math.isqrt(int(name[3:])) - 1)
    stack = stack_of(basis, directions, peak=peak)
    exact, fine, coarse = measure_rti(stack, *split_lights(60, 5), name, (None, 100, 50))
    assert exact.psnr_pooled > 100
    assert 35 < fine.psnr_pooled < 100
    assert coarse.psnr_pooled < fine.psnr_pooled
    assert coarse.encoded_bytes < fine.encoded_bytes < exact.encoded_bytes
    assert exact.encoded_bytes == basis.shape[1] * 20 * 24 * 3 * 4


@pytest.mark.parametrize("name", ["pca9", "pca18", "pca27"])
def test_principal_components_of_a_smooth_stack(name):
    directions = lights(80)
    stack = stack_of(ptm_basis(directions), directions)
    exact, fine = measure_rti(stack, *split_lights(80, 5), name, (None, 98))
    # Between lights the axes are interpolated, at them they are rounded to 8 bits.
    assert exact.psnr_pooled > 32
    assert exact.psnr_pooled_fitted > 38
    assert fine.psnr_pooled_fitted > 30
    count = int(name[3:])
    tables = 64 * 3 * (count + 1) + 8 * (count + 1)
    assert exact.encoded_bytes == tables + count * 20 * 24 * 4


def test_only_pixels_of_the_mask_count():
    directions = lights(40)
    stack = stack_of(hsh_basis(directions, 1), directions)
    images = stack.images_ihwc.copy()
    images[:, :10] = np.random.default_rng(0).random(images[:, :10].shape)
    mask = np.zeros((20, 24), bool)
    mask[10:] = True
    masked = LightStack(images, directions, peak=1.0, mask_hw=mask)
    assert measure_rti(masked, *split_lights(40, 5), "hsh4", (None,))[0].psnr_pooled > 100
    whole = LightStack(images, directions, peak=1.0)
    assert measure_rti(whole, *split_lights(40, 5), "hsh4", (None,))[0].psnr_pooled < 20


@pytest.mark.parametrize("basis", ["ptm", "pca9", "rbf"])
def test_pixels_outside_the_mask_are_free_and_do_not_matter(basis):
    directions = lights(40)
    stack = stack_of(ptm_basis(directions), directions)  # blocks of JPEG are 8 x 8
    images = stack.images_ihwc.copy()
    images[:, :8] = np.random.default_rng(0).random(images[:, :8].shape)
    mask = np.zeros((20, 24), bool)
    mask[8:] = True
    split = split_lights(40, 5)
    below = LightStack(images[:, 8:], directions, peak=1.0)
    masked = LightStack(images, directions, peak=1.0, mask_hw=mask)
    alone, beside = (measure_rti(s, *split, basis, (None, 90)) for s in (below, masked))
    assert [found.psnr_pooled for found in beside] == pytest.approx([found.psnr_pooled for found in alone], abs=0.3)
    assert beside[0].encoded_bytes == alone[0].encoded_bytes
    assert beside[1].encoded_bytes < 1.15 * alone[1].encoded_bytes
    assert not any(plane[:8].any() for plane in fit_rti(masked, split[0], basis).planes)


def test_all_photographs_are_met_at_their_lights_and_interpolated_between():
    directions = lights(60)
    stack = stack_of(directions, directions)
    fitted, held = split_lights(60, 5)
    found = fit_rti(stack, fitted, "rbf")
    for i in fitted[:5]:
        np.testing.assert_allclose(found.relight(found.planes, int(i)), stack.images_ihwc[i], atol=1e-5)
    exact, coded = measure_rti(stack, fitted, held, "rbf", (None, 95))
    assert exact.psnr_pooled > 30
    assert coded.psnr_pooled > 30
    assert exact.encoded_bytes == 48 * 20 * 24 * 3 * 4


def test_photographs_of_one_light_are_averaged():
    directions = np.repeat(lights(20), 2, axis=0)
    stack = stack_of(directions, directions, noise=0.02)
    found = fit_rti(stack, np.arange(40), "rbf")
    image = found.relight(found.planes, 6)
    np.testing.assert_allclose(image, stack.images_ihwc[6:8].mean(axis=0), atol=1e-4)


def test_psnr_is_that_of_the_decoded_values():
    """One function, one channel: the whole way by hand."""
    directions = lights(10)
    rng = np.random.default_rng(0)
    images = rng.random((10, 8, 8, 1)).astype(np.float32)
    fitted, held = split_lights(10, 5)
    found = measure_rti(LightStack(images, directions, peak=1.0), fitted, held, "hsh4", (None,))[0]
    basis = hsh_basis(directions, 1)
    coeffs = np.linalg.lstsq(basis[fitted], images[fitted].reshape(8, -1).astype(float), rcond=None)[0]
    error = np.square(np.clip(basis[held] @ coeffs, 0, 1) - images[held].reshape(2, -1)).mean(axis=1)
    assert found.psnr_pooled == pytest.approx(-10 * np.log10(error.mean()), abs=1e-3)
    assert found.psnr_mean == pytest.approx(np.mean(-10 * np.log10(error)), abs=1e-3)


def test_planes_are_scaled_over_their_central_range(monkeypatch):
    from PIL import Image

    written = []
    original = Image.Image.save

    def save(self, file, *args, **kwargs):
        original(self, file, *args, **kwargs)
        written.append((np.array(self), file.getvalue()))

    monkeypatch.setattr(Image.Image, "save", save)
    plane = np.linspace(-3, 5, 2000, dtype=np.float32).reshape(40, 50, 1)
    plane[0, 0] = 1000  # an outlier, which may not take the range
    colours = np.repeat(plane, 3, axis=2) * np.float32([1, 2, 0])
    size, (gray, colour) = compress_planes([plane, colours], 95)
    assert written[0][0].min() == 0
    assert written[0][0].max() == 255
    assert size == sum(len(data) for _, data in written) + 8 + 24
    assert [Image.open(io.BytesIO(data)).mode for _, data in written] == ["L", "RGB"]
    inner = np.abs(plane) < 4.5
    assert np.abs(gray - plane)[inner].max() < 0.05 * 8
    assert np.abs(colour - colours)[np.repeat(inner, 3, axis=2)].max() < 0.05 * 16 * 2


def test_what_cannot_be_is_refused(monkeypatch):
    directions = lights(12)
    stack = stack_of(ptm_basis(directions), directions)
    split = split_lights(12, 5)
    for basis, qualities, message in [
        ("sh", (90,), "ptm, hsh4"),
        ("ptm", (0,), "quality"),
        ("ptm", (101,), "quality"),
        ("hsh16", (90,), "16 lights"),
    ]:
        with pytest.raises(InputError, match=message):
            measure_rti(stack, *split, basis, qualities)
    with pytest.raises(InputError, match="held out"):
        measure_rti(stack, *split_lights(12, None), "ptm")
    two = stack.select(np.arange(4))
    with pytest.raises(InputError, match="lights"):
        measure_rti(two, np.arange(2), np.arange(2, 4), "pca9")
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(InputError, match=r"clrelight\[codecs\]"):
        measure_rti(stack, *split, "ptm")


def test_every_basis_runs_on_one_pixel():
    directions = lights(50)
    stack = stack_of(ptm_basis(directions), directions, shape=(1, 1, 1))
    for basis in BASES:
        found = measure_rti(stack, *split_lights(50, 5), basis, (90, None))
        assert all(np.isfinite(f.psnr_pooled) for f in found)
