"""Fits of other bases than harmonics in files of other viewers: shown as the basis' published formulas say."""

from functools import cache

import numpy as np
import pytest

import clrelight as cr
from clrelight.exchange.ptm import read_ptm
from clrelight.exchange.rti import read_rti
from clrelight.images import read_header, read_image
from clrelight.store import write_fit
from tests.commands import call, succeed
from tests.reference import bases as reference
from tests.reference.basis import real_harmonics
from tests.test_exchange import LIGHTS, decibels, made_fit, ptm_by_the_letter, shown_by_openlime

SMOOTH = ("hsh", "gram-schmidt", "zernike", "makhotkin")
DEGREE = 3


@cache
def fit_of(name, transfer="linear"):
    """Return the view of `made_fit` in another basis, as near as its functions come."""
    view = made_fit(2, 24, 31)
    lights, weight = reference.hemisphere_quadrature(12)
    radiance = real_harmonics(lights, 2) @ view.coeffs_khwc.reshape(9, -1)
    root = np.sqrt(weight)[:, None]
    coeffs = np.linalg.lstsq(root * reference.FUNCTIONS[name](lights, DEGREE), root * radiance, rcond=None)[0]
    coeffs_khwc = coeffs.reshape(-1, *view.image_shape).astype(np.float32)
    return cr.CoefficientMap(coeffs_khwc, DEGREE, "uls", 255.0, transfer, LIGHTS, {"basis": name}, name="made")


def shown(fit, functions):
    """Return display values under `LIGHTS`, the coefficients being of some functions."""
    radiance = np.einsum("ik,khwc->ihwc", functions(LIGHTS, DEGREE), fit.coeffs_khwc.astype(float))
    clipped = np.clip(radiance, 0, 1)
    if fit.transfer == "srgb":
        return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return clipped


def found_in(place, fit, name):
    """Write a fit and export it; return what other programs show under `LIGHTS`, and what is told."""
    write_fit(place / "fit.h5", fit)
    out = place / name
    words = ("--format", "relight", "--planes", 48) if not out.suffix else ()
    told = succeed("export", place / "fit.h5", out, *words, "--json").json
    if out.suffix == ".ptm":
        return ptm_by_the_letter(out.read_bytes()), told
    if out.suffix == ".rti":
        return read_rti(out).display_values(LIGHTS, 0, 24), told
    return np.stack([shown_by_openlime(out, light) for light in LIGHTS]), told


@pytest.mark.parametrize("basis", [*SMOOTH, "haar"])
@pytest.mark.parametrize("name", ["folder", "x.ptm", "x.rti"])
def test_they_show_the_basis(tmp_path, basis, name):
    fit = fit_of(basis)
    found, told = found_in(tmp_path, fit, name)
    expected = shown(fit, reference.FUNCTIONS[basis])
    assert expected.std() > 0.02
    # Steps of light are no polynomials, nor are they between the cells of a table.
    assert decibels(found, expected) > (36 if basis == "haar" else 50 if name == "folder" else 44)
    assert decibels(shown(fit, real_harmonics), expected) < 20  # what taking them for harmonics would show
    if name != "folder":
        assert told["refit"] == pytest.approx(decibels(found, expected), abs=5)


@pytest.mark.parametrize("name", ["folder", "x.ptm", "x.rti"])
def test_the_curve_is_that_of_the_stack(tmp_path, name):
    fit = fit_of("zernike", "srgb")
    found, _ = found_in(tmp_path, fit, name)
    assert decibels(found, shown(fit, reference.FUNCTIONS["zernike"])) > 46


def test_an_encoding_is_of_its_basis_too(tmp_path):
    fit = fit_of("gram-schmidt")
    write_fit(tmp_path / "fit.h5", fit)
    succeed("encode", tmp_path / "fit.h5", tmp_path / "enc.h5", "--codec", "klt", "--step", 0.001)
    expected = shown(fit, reference.FUNCTIONS["gram-schmidt"])
    for name, reader in (("x.ptm", read_ptm), ("x.rti", read_rti)):
        succeed("export", tmp_path / "enc.h5", tmp_path / name)
        assert decibels(reader(tmp_path / name).display_values(LIGHTS, 0, 24), expected) > 44
    succeed("export", tmp_path / "enc.h5", tmp_path / "folder", "--format", "relight", "--tiles", "deepzoom")
    succeed("import", tmp_path / "folder", tmp_path / "back.h5", "--lights", 8)
    with cr.open_stack(tmp_path / "back.h5") as stack:
        radiance = np.einsum(
            "ik,khwc->ihwc", reference.FUNCTIONS["gram-schmidt"](stack.directions_i3, DEGREE), fit.coeffs_khwc
        )
        assert decibels(np.asarray(stack.images_ihwc) / 255, np.clip(radiance, 0, 1)) > 44


def test_a_picture_in_tiles(tmp_path):
    fit = fit_of("makhotkin")
    write_fit(tmp_path / "fit.h5", fit)
    words = ("--format", "deepzoom", "--light", ",".join(map(str, LIGHTS[0])), "--quality", 100)
    succeed("export", tmp_path / "fit.h5", tmp_path / "tiles", *words)
    finest = max((tmp_path / "tiles" / "picture_files").iterdir(), key=lambda each: int(each.name))
    expected = shown(fit, reference.FUNCTIONS["makhotkin"])[0]
    found = read_image(read_header(finest / "0_0.jpg")) / 255
    assert decibels(found, expected) > 36


@pytest.mark.parametrize("name", ["maps.exr", "maps.ktx2"])
def test_files_of_coefficients_want_harmonics(tmp_path, name):
    write_fit(tmp_path / "fit.h5", fit_of("zernike"))
    ended = call("export", tmp_path / "fit.h5", tmp_path / name)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "zernike" in ended.err
    assert not (tmp_path / name).exists()
