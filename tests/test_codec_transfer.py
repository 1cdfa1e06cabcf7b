"""The codec klt behind a transfer curve: errors are alike in code values instead of in radiance."""

import itertools

import numpy as np
import pytest

from clrelight.codec import codec_class, decode, decode_view, encode
from clrelight.codec.formats.klt import Klt
from clrelight.codec.formats.klt_units import parse_body
from clrelight.codec.transforms import colour
from clrelight.codec.transforms.code_values import code_values_of, radiance_of
from clrelight.conventions import srgb_to_linear
from clrelight.dataset import LightStack
from clrelight.errors import InputError, PayloadError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.store import write_stack
from tests.commands import call, succeed
from tests.reference.klt4 import decode_klt4


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
    assert encoded.body[at] & 9 == 1 + 8  # the curve, and tables by shells
    with pytest.raises(PayloadError, match="transfer curve 1 and basis 6"):
        Klt.decode_body(encoded.body[:at] + b"\x69" + encoded.body[at + 1 :], encoded.shape, device)


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


LAB_OF_GREY = (0.2126, 0.7152, 0.0722)


def lab(radiance):
    """CIE 15 and IEC 61966-2-1: lightness, a, b."""
    xyz = np.array([[0.4124, 0.3576, 0.1805], LAB_OF_GREY, [0.0193, 0.1192, 0.9505]])
    ratio = np.clip(radiance, 0, None) @ xyz.T / xyz.sum(axis=1)
    root = np.where(ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16) / 116)
    return np.stack(
        [116 * root[..., 1] - 16, 500 * (root[..., 0] - root[..., 1]), 200 * (root[..., 1] - root[..., 2])], -1
    )


def test_lab_is_that_of_the_standard():
    given = np.random.default_rng(0).random((50, 3))
    np.testing.assert_allclose(colour.to_lab(given), lab(given), atol=0.02)
    np.testing.assert_allclose(colour.to_lab(np.ones(3)), [100, 0, 0], atol=1e-9)


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_axes_are_those_of_small_differences(transfer):
    axes = colour.colour_axes("perceptual", transfer)
    assert np.abs(axes).max() == 1.0
    grey = 0.5 if transfer == "srgb" else srgb_to_linear(0.5)
    radiance = srgb_to_linear if transfer == "srgb" else np.asarray
    shift = 1e-3 * np.random.default_rng(1).standard_normal((20, 3))
    differences = np.linalg.norm(lab(radiance(grey + shift)) - lab(radiance(np.full(3, grey))), axis=1)
    ratio = np.linalg.norm(shift @ axes.T, axis=1) / differences
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=0.02)
    assert colour.colour_axes("radiance", transfer) is None


def seen(coeffs):
    """In CIELAB, under every seventh of the directions."""
    return lab(np.clip(show(coeffs)[::7], 0, 1))


def test_colours_are_kept_at_the_cost_of_lightness(device):
    rng = np.random.default_rng(2)
    tint = np.array([0.5, 0.2, 0.15]) + 0.05 * rng.standard_normal((24, 32, 3)).repeat(2, 0).repeat(2, 1)
    coeffs = (shaded_sphere(64)[:, :48] / 0.3 * tint[None]).astype(np.float32)
    chroma, whole = {"radiance": 0.0, "perceptual": 0.0}, {"radiance": 0.0, "perceptual": 0.0}
    exact = seen(coeffs)
    for metric, budget in itertools.product(chroma, (700, 800, 900)):  # of a few bytes: one may be had by luck
        codec = codec_class("klt").from_config({"byte_budget": budget, "transfer": "srgb", "metric": metric})
        payload = encode(coeffs, codec, device).to_bytes()
        error = seen(decode(payload, device)) - exact
        chroma[metric] += np.mean(error[..., 1:] ** 2)
        whole[metric] += np.mean(np.sum(error**2, -1))
    assert chroma["perceptual"] < 0.9 * chroma["radiance"]
    # Lightness pays: of 16 budgets either metric has the lesser whole in about half, by 2% at most.
    assert whole["perceptual"] < 1.01 * whole["radiance"]


def test_bodies_of_either_metric_are_read_alike(device):
    coeffs = shaded_sphere(24)
    encoded = encode(coeffs, Klt(rate=1.0, transfer="linear", metric="perceptual"), device)
    found, expected = decode(encoded, device), decode_klt4(encoded.body, encoded.shape)
    np.testing.assert_allclose(found, expected.coeffs, atol=1e-5 * np.abs(coeffs).max())
    assert np.abs(show(found) - show(coeffs)).max() < 0.05


def test_a_metric_that_there_is_not_and_images_without_colours(device):
    with pytest.raises(InputError, match="klt metric must be one of radiance, perceptual, got 'flip'"):
        Klt(metric="flip")
    with pytest.raises(InputError, match="metric perceptual is for red, green and blue, the images have 1 channel"):
        encode(shaded_sphere(16)[..., :1], Klt(metric="perceptual"), device)


def test_the_curve_of_finite_values_has_the_same_bits(device):
    """Where samples are integers the kernel of planes leaves out what infinities and NaN need."""
    rng = np.random.default_rng(3)
    powers = np.ldexp(1.0 + rng.random(4096), rng.integers(-140, 127, 4096))
    values = np.concatenate([powers, -powers, rng.random(4096), [0.0, -0.0, 0.0031308, 1.0]]).astype(np.float32)
    values = values[np.isfinite(values)]
    bent = []
    for finite in (0, 1):
        held = device.hold(values.copy())
        defines = {"VECTOR": device.info.lanes, "DECODE": 0, "STRETCH": len(values), "FINITE": finite}
        device.launch("codec/bend.cl", "bend_values_p", (1,), held, len(values), defines=defines)
        bent.append(device.download(held).view(np.int32))
    np.testing.assert_array_equal(*bent)
