"""Real photographs through the whole program, against float64 computed here."""

import json

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.commands import arrays, attributes, call, succeed
from tests.reference.basis import real_harmonics
from tests.reference.psnr import decode as decode_srgb
from tests.reference.psnr import mean_squared_errors, psnr

STACKS = {
    "loewenkopf": ("loewenkopf", ["--transfer", "srgb"], (240, 43, 64, 3)),
    "cat": ("diligent/catPNG", ["--crop", "200,150,90,80"], (96, 80, 90, 3)),
    "psbox_cat": ("psbox_cat", ["--crop", "100,150,120,90"], (12, 90, 120, 1)),
    "univr_dome": ("univr_dome", ["--transfer", "srgb", "--crop", "100,100,100,80"], (49, 80, 100, 3)),
}


@pytest.fixture(scope="module")
def stack(real_data, tmp_path_factory):
    """Return the file of a stack, ingested once."""
    folder, made = tmp_path_factory.mktemp("stacks"), {}

    def ingest(name):
        if name not in made:
            source, options, shape = STACKS[name]
            made[name] = folder / f"{name}.h5"
            ended = call("ingest", real_data / "stacks" / source, made[name], "--name", name, *options, "--json")
            assert ended.code == 0, ended.err
            assert ended.json["n_light"] == shape[0]
        return made[name]

    return ingest


def radiance(path):
    values = arrays(path)["images"].astype(np.float64) / attributes(path)["peak"]
    return decode_srgb_table(values) if attributes(path)["transfer"] == "srgb" else values


def decode_srgb_table(values):
    """Decode 8-bit codes by a table of 256: the reference takes one value at a time."""
    codes = np.rint(values * 255).astype(int)
    return decode_srgb(np.arange(256) / 255.0)[codes]


@pytest.mark.parametrize("name", STACKS)
def test_stack_fit_psnr_relight(stack, tmp_path, name):
    path = stack(name)
    shape = STACKS[name][2]
    images, directions = radiance(path), arrays(path)["directions"]
    assert images.shape == shape
    degree = 2
    fit, picture = tmp_path / "fit.h5", tmp_path / "a.exr"
    told = succeed("fit", path, fit, "--method", "uls", "--degree", degree, "--json").json
    basis = real_harmonics(directions, degree)
    expected = np.linalg.lstsq(basis, images.reshape(len(images), -1), rcond=None)[0].reshape(9, *images.shape[1:])
    mask = arrays(path).get("mask", np.ones(images.shape[1:3], np.uint8)) > 0
    expected[:, ~mask] = 0
    held = arrays(fit)["coefficients"].astype(np.float64)
    # Coefficients of a narrow cap are large and cancel, so it is their images that must agree.
    relit = np.einsum("ik,khwc->ihwc", basis, expected)
    assert np.abs(np.einsum("ik,khwc->ihwc", basis, held) - relit).max() < 2e-4
    transfer, peak = attributes(path)["transfer"], attributes(path)["peak"]
    mse = mean_squared_errors(relit, arrays(path)["images"], peak, transfer, mask)
    measured = succeed("psnr", fit, path, "--json").json["psnr"]
    for quality in (told["psnr"], measured):
        np.testing.assert_allclose(quality["mean_fitted"], psnr(mse).mean(), atol=2e-3)
        np.testing.assert_allclose(quality["pooled_fitted"], psnr(mse.mean()), atol=2e-3)
    light = ",".join(map(repr, map(float, directions[3])))
    succeed("relight", fit, picture, "--light", light)
    pixels = np.asarray(oiio.ImageBuf(str(picture)).get_pixels(oiio.FLOAT)).reshape(images.shape[1:])
    np.testing.assert_allclose(pixels, relit[3], atol=2e-4)


def test_diligent_peak_is_the_white_of_a_mean_light(stack, real_data):
    path = stack("cat")
    intensities = np.loadtxt(real_data / "stacks" / "diligent" / "catPNG" / "light_intensities.txt")
    held = arrays(path)
    assert (attributes(path)["peak"], held["images"].dtype) == (1.0, np.float16)
    first = oiio.ImageBuf(str(real_data / "stacks" / "diligent" / "catPNG" / "001.png"))
    codes = np.asarray(first.get_pixels(oiio.FLOAT), np.float64)[150:230, 200:290]
    expected = codes * intensities.mean() / intensities[0]
    np.testing.assert_allclose(held["images"][0].astype(np.float64), expected, rtol=2.0**-11)
    assert held["mask"].any()
    assert not held["mask"].all()


def test_ingest_says_how_it_understood_the_folder(real_data, tmp_path):
    ended = call("ingest", real_data / "stacks" / "diligent" / "catPNG", tmp_path / "o.h5", "--subset", "::12")
    assert ended.code == 0
    assert "note: divided by the light intensities; 1 is white under a light of mean intensity" in ended.err
    assert "note: mask mask.png" in ended.err
    assert "images      8 of" in ended.out


def test_bench_and_report_of_photographs(stack, tmp_path):
    path = stack("loewenkopf")
    words = ["--methods", "uls,cls", "--degrees", 2, "--codecs", "none,s3tc", "--holdout", 5]
    rows = succeed("bench", path, "--out", tmp_path / "r.h5", *words, "--json").json["rows"]
    by_key = {(row["method"], row["codec"]): row for row in rows}
    assert len(by_key) == 4
    assert {(row["n_light"], row["n_holdout"], row["scene"]) for row in rows} == {(192, 48, "loewenkopf")}
    for method in ("uls", "cls"):
        assert by_key[method, "s3tc"]["psnr_pooled"] < by_key[method, "none"]["psnr_pooled"]
    assert by_key["uls", "none"]["mean_energy"] > by_key["cls", "none"]["mean_energy"]
    succeed("report", tmp_path / "r.h5", "--out", tmp_path / "report")
    page = (tmp_path / "report" / "report.md").read_text()
    for row in rows:
        assert f"{row['psnr_mean']:.2f}" in page
    for name in ("tables/all_rows.csv", "figures/contact_sheet.png"):
        assert (tmp_path / "report" / name).stat().st_size > 100


def test_from_photographs_to_a_picture_of_few_bytes(stack, tmp_path):
    """The README's walk."""
    path = stack("loewenkopf")
    fit, enc, picture = tmp_path / "fit.h5", tmp_path / "enc.h5", tmp_path / "relit.png"
    ended = call("fit", path, fit, "--method", "cls", "--degree", 4, "--holdout", 5, "--json")
    told = succeed("encode", fit, enc, "--codec", "klt", "--rate", 0.2, "--stack", path, "--json").json
    assert told["bits_per_coefficient"] <= 0.2
    assert told["psnr"]["pooled_holdout"] > ended.json["psnr"]["pooled_holdout"] - 2
    assert json.loads(attributes(fit)["config"])["iterations"] == 32
    succeed("relight", enc, picture, "--light", "0.5,0.2,0.8")
    shown = np.asarray(oiio.ImageBuf(str(picture)).get_pixels(oiio.UINT8))
    assert shown.shape == (43, 64, 3)
    assert shown.std() > 20
