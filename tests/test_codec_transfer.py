"""The codec klt behind a transfer curve: errors are alike in code values instead of in radiance."""

import numpy as np
import pytest

from clrelight.codec import codec_class, decode, decode_view, encode
from clrelight.codec.formats.klt import Klt
from clrelight.codec.formats.klt_units import parse_body
from clrelight.codec.transforms.code_values import code_values_of, radiance_of
from clrelight.conventions import srgb_to_linear
from clrelight.dataset import LightStack
from clrelight.errors import InputError, PayloadError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.store import write_stack
from tests.commands import call, succeed


def dense_hemisphere():
    """Directions and weights of a quadrature of this test's own: uniform in z and azimuth."""
    z, azimuth = np.meshgrid((np.arange(40) + 0.5) / 40, 2 * np.pi * np.arange(80) / 80, indexing="ij")
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], -1).reshape(-1, 3)


def srgb(linear):
    """IEC 61966-2-1, of magnitudes."""
    size = np.abs(linear)
    return np.sign(linear) * np.where(size <= 0.0031308, 12.92 * size, 1.055 * size ** (1 / 2.4) - 0.055)


def shaded_sphere(size=32, degree=4):
    """Coefficients of a Lambertian sphere: half of every pixel's lights leave it in the shade."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    normals = np.stack([x, y, np.sqrt(np.maximum(1.2 - x * x - y * y, 0.05))], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    albedo = 0.3 + 0.2 * np.sin(9 * x)[..., None] * np.array([1.0, 0.5, -0.5])
    directions = dense_hemisphere()
    shading = np.maximum(np.einsum("id,hwd->ihw", directions, normals), 0.02)
    basis = evaluate_basis(directions, degree)
    solved = np.linalg.lstsq(basis, shading.reshape(len(basis), -1), rcond=1e-3)[0].reshape(-1, size, size)
    return (solved[..., None] * albedo).astype(np.float32)


def show(coeffs_khwc, degree=4):
    return np.einsum("ik,khwc->ihwc", evaluate_basis(dense_hemisphere(), degree), coeffs_khwc.astype(np.float64))


def test_code_values_are_those_of_least_squares_at_the_nodes(device):
    degree, coeffs = 4, shaded_sphere(8)
    nodes, weights = np.polynomial.legendre.leggauss(degree + 1)
    z, azimuth = np.meshgrid((nodes + 1) / 2, 2 * np.pi * np.arange(2 * degree + 1) / (2 * degree + 1), indexing="ij")
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], -1).reshape(-1, 3)
    basis, root = evaluate_basis(directions, degree), np.sqrt(np.repeat(weights, 2 * degree + 1))[:, None]
    wanted = srgb(basis @ coeffs.reshape(25, -1).astype(np.float64))
    best = np.linalg.lstsq(root * basis, root * wanted, rcond=1e-3)[0].reshape(coeffs.shape)
    np.testing.assert_allclose(show(code_values_of(coeffs, device)), show(best), atol=2e-5)


def test_there_and_back_changes_little(device):
    coeffs = shaded_sphere()
    there = show(coeffs)
    back = show(radiance_of(code_values_of(coeffs, device), device))
    assert np.sqrt(np.mean((back - there) ** 2)) < 0.03 * np.sqrt(np.mean(there**2))


def test_constant_radiance_is_exact(device):
    coeffs = np.zeros((9, 2, 3, 1), np.float32)
    coeffs[0] = np.float32(0.25 * np.sqrt(4 * np.pi))
    values = code_values_of(coeffs, device)
    np.testing.assert_allclose(show(values, 2), srgb(np.float64(0.25)), rtol=2e-6)
    np.testing.assert_allclose(show(radiance_of(values, device), 2), 0.25, rtol=5e-6)


def test_code_values_are_better_at_equal_bytes(device):
    coeffs, errors = shaded_sphere(), []
    shown = srgb(np.clip(show(coeffs), 0, 1))
    for transfer in ("linear", "srgb"):
        encoded = encode(coeffs, Klt(byte_budget=900, transfer=transfer), device)
        decoded = show(decode(encoded.to_bytes(), device))
        errors.append(np.mean((srgb(np.clip(decoded, 0, 1)) - shown) ** 2))
    assert 10 * np.log10(errors[0] / errors[1]) > 1.0


def test_dark_and_negative_radiance_bend_alike(device):
    coeffs = shaded_sphere(8)
    np.testing.assert_array_equal(code_values_of(-coeffs, device), -code_values_of(coeffs, device))


@pytest.mark.parametrize(("byte_budget", "better"), [(900, "srgb"), (6000, "linear")])
def test_code_values_are_left_where_radiance_is_better(device, byte_budget, better):
    # What a degree loses of the bent function is less than a small budget does, and more than a large one.
    coeffs = shaded_sphere()
    shown, errors, curves = srgb(np.clip(show(coeffs), 0, 1)), {}, {}
    for transfer in ("linear", "srgb"):
        encoded = encode(coeffs, Klt(byte_budget=byte_budget, transfer=transfer), device)
        curves[transfer] = parse_body(encoded.body, encoded.shape).head.transfer
        decoded = show(decode(encoded.to_bytes(), device))
        errors[transfer] = np.mean((srgb(np.clip(decoded, 0, 1)) - shown) ** 2)
    assert curves == {"linear": "linear", "srgb": better}
    assert errors["srgb"] <= errors["linear"]


def test_linear_is_what_nothing_said_means(device):
    coeffs = shaded_sphere(16)
    assert encode(coeffs, Klt(step=0.02, transfer="linear"), device).body == encode(coeffs, Klt(step=0.02), device).body


def test_a_stack_fills_in_what_is_left_open():
    assert Klt(step=0.1).for_transfer("srgb") == Klt(step=0.1, transfer="srgb")
    assert Klt(step=0.1, transfer="linear").for_transfer("srgb") == Klt(step=0.1, transfer="linear")
    half = codec_class("half")()
    assert half.for_transfer("srgb") is half


def test_code_values_are_evaluated_at_a_light_before_they_become_radiance(device):
    coeffs = shaded_sphere(16)
    values = code_values_of(coeffs, device)
    exact = encode(values, Klt(step=1e-4, transfer="linear"), device)
    bent = encode(coeffs, Klt(step=1e-4, transfer="srgb"), device)
    directions = dense_hemisphere()[::500]
    in_code_values = decode_view(exact, device).relight(directions, device)
    image = decode_view(bent, device).relight(directions, device)
    expected = np.copysign(srgb_to_linear(np.abs(in_code_values)), in_code_values)
    if parse_body(bent.body, bent.shape).head.transfer == "srgb":
        np.testing.assert_allclose(image, expected, atol=2e-4)


def test_unknown_curves_are_refused(device):
    with pytest.raises(InputError, match="klt transfer must be one of linear, srgb, got 'gamma'"):
        Klt(transfer="gamma")
    encoded = encode(shaded_sphere(8), Klt(step=0.05, transfer="srgb"), device)
    at = 10  # behind version, levels, exponent, step and count
    assert encoded.body[at] == 1
    with pytest.raises(PayloadError, match="transfer curve 7"):
        Klt.decode_body(encoded.body[:at] + b"\7" + encoded.body[at + 1 :], encoded.shape, device)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A folder with a stack behind the sRGB curve, and its fit."""
    folder = tmp_path_factory.mktemp("srgb")
    directions = dense_hemisphere()[::37]
    images = np.rint(255 * srgb(np.clip(show(shaded_sphere(16))[::37], 0, 1))).astype(np.uint8)
    write_stack(folder / "stack.h5", LightStack(images, directions, 255.0, "srgb"))
    succeed("fit", folder / "stack.h5", folder / "fit.h5", "--degree", 4)
    return folder


def test_the_fit_says_which_curve(fitted):
    enc = fitted / "enc.h5"
    found = succeed("encode", fitted / "fit.h5", enc, "--codec", "klt", "--step", 0.03, "--json").json
    assert found["config"]["transfer"] == "srgb"
    asked = ("--codec", "klt", "--step", 0.03, "--transfer", "linear", "--json")
    assert succeed("encode", fitted / "fit.h5", enc, *asked).json["config"]["transfer"] == "linear"
    aimed = succeed("encode", fitted / "fit.h5", enc, "--target-psnr", 25, "--stack", fitted / "stack.h5", "--json")
    assert aimed.json["config"]["transfer"] == "srgb"
    succeed("relight", enc, fitted / "relit.png", "--light", "0,0,1")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--codec", "half", "--transfer", "srgb"), "codec half has no option 'transfer'"),
        (("--codec", "klt", "--transfer", "gamma"), "'gamma' is not one of 'linear', 'srgb'"),
    ],
)
def test_bad_curves_write_nothing(fitted, tmp_path, words, expected):
    ended = call("encode", fitted / "fit.h5", tmp_path / "out.h5", *words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert expected in ended.err
    assert not list(tmp_path.iterdir())
