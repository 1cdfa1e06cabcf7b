"""The whole walk through the commands on a small ring, and what lies in every file on the way."""

import json
import re

import numpy as np
import OpenImageIO as oiio
import pytest

from clrelight.cli.app import cli
from clrelight.codec import codec_ids
from clrelight.fit import method_ids
from clrelight.store import read_encoded
from tests.commands import arrays, attributes, call, contents, process, succeed
from tests.reference.basis import real_harmonics
from tests.reference.psnr import display, mean_squared_errors, psnr
from tests.reference.psnr import encode as encode_srgb

DEGREE = 3
CODECS = ("half", "s3tc", "bc6h", "uniform", "wavelet", "klt", "cpca", "vq")


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    path = tmp_path_factory.mktemp("ring") / "ring.h5"
    succeed("synth", "ring", path, "--size", 32, "--lights", 64)
    return path


@pytest.fixture(scope="module")
def fitted(ring):
    path = ring.with_name("fit.h5")
    succeed("fit", ring, path, "--degree", DEGREE, "--holdout", 5)
    return path


def read_picture(path):
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT), np.float64)


def relit(path, directions_i3):
    """Return images in float64 of the coefficients in a fit file."""
    coeffs = arrays(path)["coefficients"].astype(np.float64)
    return np.einsum("ik,khwc->ihwc", real_harmonics(directions_i3, int(np.sqrt(len(coeffs))) - 1), coeffs)


def expected_psnr(stack_path, fit_path, lights):
    stack = arrays(stack_path)
    images, directions = stack["images"][lights], stack["directions"][lights]
    whole = np.ones(images.shape[1:3], bool)
    mse = mean_squared_errors(relit(fit_path, directions), images, 255.0, "linear", whole)
    return psnr(mse).mean(), psnr(mse.mean())


def test_synth_holds_the_ring(ring):
    held, facts = arrays(ring), attributes(ring)
    assert held["images"].shape == (64, 32, 32, 3)
    assert held["images"].dtype == np.uint8
    assert held["images"].std() > 20
    np.testing.assert_allclose(np.linalg.norm(held["directions"], axis=1), 1, atol=1e-12)
    assert held["directions"][:, 2].min() > 0
    assert (facts["clrelight_schema"], facts["peak"], facts["transfer"], facts["name"]) == (
        "stack/1",
        255.0,
        "linear",
        "ring",
    )


def test_info_tells_what_there_is(ring, fitted):
    told = succeed("info", ring, "--json").json
    assert (told["schema"], told["bytes_on_disk"]) == ("stack/1", ring.stat().st_size)
    assert told["datasets"]["images"]["shape"] == [64, 32, 32, 3]
    assert told["attributes"] == {"peak": 255.0, "transfer": "linear", "name": "ring"}
    assert succeed("info", fitted, "--json").json["attributes"]["method"] == "cls"
    lines = succeed("info", ring).out.splitlines()
    assert any(line.split() == ["shape", "64", "×", "32", "×", "32", "×", "3"] for line in lines)


@pytest.mark.parametrize("method", method_ids())
def test_fit_by_every_method(ring, tmp_path, method):
    out = tmp_path / "fit.h5"
    ended = call("fit", ring, out, "--method", method, "--degree", DEGREE, "--json")
    assert ended.code == 0
    told, held = ended.json, arrays(out)
    assert held["coefficients"].shape == (16, 32, 32, 3)
    assert held["coefficients"].dtype == np.float32
    np.testing.assert_array_equal(held["directions"], arrays(ring)["directions"])
    assert (told["method"], told["degree"], told["n_coeff"], told["n_light"]) == (method, DEGREE, 16, 64)
    assert (attributes(out)["method"], json.loads(attributes(out)["config"])) == (method, told["config"])
    steps = {"fit"} if method == "cls" else {"project", "shrink", "synthesize"}
    assert {"plan", "read", *steps, "measure", "write"} <= told["seconds"].keys()
    assert min(told["seconds"].values()) >= 0
    assert told["device"]
    mean, pooled = expected_psnr(ring, out, np.arange(64))
    np.testing.assert_allclose((told["psnr"]["mean_fitted"], told["psnr"]["pooled_fitted"]), (mean, pooled), atol=1e-3)
    assert ("lambda" in held, "rank" in held) == (method in ("cls", "constrained"), method.startswith("ceb"))


def test_held_out_lights_are_every_fifth(ring, fitted, tmp_path):
    index = np.arange(64)
    seen, unseen = index[index % 5 != 4], index[index % 5 == 4]
    directions = arrays(ring)["directions"]
    np.testing.assert_array_equal(arrays(fitted)["directions"], directions[seen])
    told = succeed("fit", ring, tmp_path / "fit.h5", "--degree", DEGREE, "--holdout", 5, "--json").json
    assert (told["n_light"], told["n_holdout"]) == (52, 12)
    expected = [*expected_psnr(ring, fitted, seen), *expected_psnr(ring, fitted, unseen)]
    names = ("mean_fitted", "pooled_fitted", "mean_holdout", "pooled_holdout")
    np.testing.assert_allclose([told["psnr"][name] for name in names], expected, atol=1e-3)
    # psnr finds from the file which lights the fit has not seen.
    measured = succeed("psnr", fitted, ring, "--json").json
    np.testing.assert_allclose([measured["psnr"][name] for name in names], expected, atol=1e-3)
    assert {"read", "measure"} <= measured["seconds"].keys()
    text = succeed("psnr", fitted, ring).out
    assert f"{expected[0]:.2f} dB mean over lights, {expected[1]:.2f} dB pooled" in text
    assert f"{expected[2]:.2f} dB mean over lights, {expected[3]:.2f} dB pooled" in text


def test_fit_without_measuring(ring, fitted, tmp_path):
    told = succeed("fit", ring, tmp_path / "f.h5", "--degree", DEGREE, "--holdout", 5, "--no-measure", "--json").json
    assert "psnr" not in told
    np.testing.assert_array_equal(arrays(tmp_path / "f.h5")["coefficients"], arrays(fitted)["coefficients"])


def test_small_memory_gives_the_same_fit(ring, fitted, tmp_path):
    succeed("fit", ring, tmp_path / "f.h5", "--degree", DEGREE, "--holdout", 5, "--memory", "60k")
    np.testing.assert_array_equal(arrays(tmp_path / "f.h5")["coefficients"], arrays(fitted)["coefficients"])


@pytest.mark.parametrize("codec", CODECS)
def test_every_codec_there_and_back(ring, fitted, tmp_path, codec):
    out, back = tmp_path / "enc.h5", tmp_path / "dec.h5"
    told = succeed("encode", fitted, out, "--codec", codec, "--stack", ring, "--json").json
    facts = succeed("info", out, "--json").json["attributes"]
    assert told["encoded_bytes"] == len(read_encoded(out)[0].body) == facts["encoded_bytes"]
    bits = 8 * told["encoded_bytes"] / (16 * 32 * 32 * 3)
    np.testing.assert_allclose([told["bits_per_coefficient"], facts["bits_per_coefficient"]], bits, rtol=1e-12)
    assert (facts["codec"], facts["config"]) == (codec, told["config"])
    assert told["seconds"].keys() == {"read", "predict", "encode", "decode", "measure", "write"}
    assert told["device"]
    decoded = succeed("decode", out, back, "--json").json
    assert decoded["seconds"].keys() == {"read", "decode", "write"}
    assert decoded["encoded_bytes"] == told["encoded_bytes"]
    for name in ("method", "degree", "peak", "transfer", "name", "config"):
        assert attributes(back)[name] == attributes(fitted)[name]
    np.testing.assert_allclose(arrays(back)["directions"], arrays(fitted)["directions"], atol=8e-5)
    # What the encoder says it lost is what the decoded file has lost.
    seen = np.arange(64) % 5 != 4
    for lights, name in ((seen, "fitted"), (~seen, "holdout")):
        expected = expected_psnr(ring, back, lights)
        for measured in (told["psnr"], succeed("psnr", out, ring, "--json").json["psnr"]):
            np.testing.assert_allclose((measured[f"mean_{name}"], measured[f"pooled_{name}"]), expected, atol=2e-3)


def test_half_rounds_to_the_nearest_half(fitted, tmp_path):
    succeed("encode", fitted, tmp_path / "e.h5", "--codec", "half")
    succeed("decode", tmp_path / "e.h5", tmp_path / "d.h5")
    expected = arrays(fitted)["coefficients"].astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(arrays(tmp_path / "d.h5")["coefficients"], expected)


def test_uniform_bits_and_its_table(fitted, tmp_path):
    told = succeed("encode", fitted, tmp_path / "e.h5", "--codec", "uniform", "--bits", 3, "--json").json
    assert told["encoded_bytes"] == 1 + 8 * 16 + 16 * 32 * 32 * 3 * 3 // 8
    succeed("decode", tmp_path / "e.h5", tmp_path / "d.h5")
    for plane in arrays(tmp_path / "d.h5")["coefficients"]:
        assert len(np.unique(plane)) <= 8


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_wavelet_lands_below_the_rate(fitted, tmp_path, rate):
    told = succeed("encode", fitted, tmp_path / "e.h5", "--codec", "wavelet", "--rate", rate, "--json").json
    assert 0.99 * rate <= told["bits_per_coefficient"] <= rate


def test_whitened_basis_holds_the_codec_inside(fitted, tmp_path):
    told = succeed(
        "encode", fitted, tmp_path / "e.h5", "--basis", "whitened", "--codec", "uniform", "--bits", 5, "--json"
    ).json
    assert (told["codec"], told["config"]) == ("whitened", {"codec": "uniform", "options": {"bits": 5}})


def test_a_size_and_a_quality(ring, fitted, tmp_path):
    small = succeed("encode", fitted, tmp_path / "e.h5", "--bytes", "8k", "--json").json
    assert (small["codec"], (tmp_path / "e.h5").stat().st_size <= 8000) == ("klt", True)
    ended = call("encode", fitted, tmp_path / "e.h5", "--target-psnr", 19, "--stack", ring, "--json")
    succeed("decode", tmp_path / "e.h5", tmp_path / "d.h5")
    reached = expected_psnr(ring, tmp_path / "d.h5", np.arange(64) % 5 == 4)[1]
    assert 19 <= reached <= 19.5
    assert ended.json["encoded_bytes"] < 16 * 32 * 32 * 3 * 4 / 50


def test_relit_pixels_are_the_sum(fitted, tmp_path):
    light = np.array([0.3, -0.4, 1.5])
    expected = relit(fitted, (light / np.linalg.norm(light))[None])[0]
    told = succeed("relight", fitted, tmp_path / "a.exr", "--light", "0.3,-0.4,1.5", "--json").json
    assert told["files"] == [str(tmp_path / "a.exr")]
    assert {"read", "relight", "write"} <= told["seconds"].keys()
    np.testing.assert_allclose(read_picture(tmp_path / "a.exr"), expected, atol=1e-5)
    succeed("relight", fitted, tmp_path / "b.exr", "--light", "0.3,-0.4,1.5", "--exposure", -2)
    np.testing.assert_allclose(read_picture(tmp_path / "b.exr"), expected / 4, atol=1e-5)
    for transfer, name in ((None, "c.png"), ("srgb", "d.png")):
        extra = ["--transfer", transfer] if transfer else []
        succeed("relight", fitted, tmp_path / name, "--light", "0.3,-0.4,1.5", "--exposure", 1, *extra)
        codes = 255 * display(2 * expected, transfer or "linear")
        assert np.abs(255 * read_picture(tmp_path / name) - codes).max() <= 0.5 + 1e-3
    assert encode_srgb(0.5) > 0.7  # the two pictures above differ


def test_many_lights_many_pictures(fitted, tmp_path):
    lights = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -0.6, 0.8]])
    options = [word for light in lights for word in ("--light", ",".join(map(str, light)))]
    told = succeed("relight", fitted, tmp_path / "f%03d.exr", *options, "--json").json
    assert told["files"] == [str(tmp_path / f"f00{i}.exr") for i in range(3)]
    np.savetxt(tmp_path / "lights.txt", 3 * lights)
    succeed("relight", fitted, tmp_path / "g%d.exr", "--lights", tmp_path / "lights.txt")
    for i, expected in enumerate(relit(fitted, lights)):
        np.testing.assert_allclose(read_picture(tmp_path / f"f00{i}.exr"), expected, atol=1e-5)
        np.testing.assert_allclose(read_picture(tmp_path / f"g{i}.exr"), expected, atol=1e-5)
    (tmp_path / "l.lp").write_text("2\na.png 0 0 1\nb.png 0.6 0 0.8\n")
    succeed("relight", fitted, tmp_path / "h%d.tif", "--lights", tmp_path / "l.lp")
    assert not (tmp_path / "h2.tif").exists()
    assert len(succeed("relight", fitted, tmp_path / "50%.png", "--light", "0,0,1").out.splitlines()) == 2
    assert (tmp_path / "50%.png").exists()


@pytest.mark.parametrize("codec", ["s3tc", "klt"])
def test_encoded_file_relights_like_its_decoded_one(fitted, tmp_path, codec):
    succeed("encode", fitted, tmp_path / "e.h5", "--codec", codec)
    succeed("decode", tmp_path / "e.h5", tmp_path / "d.h5")
    for name in ("e", "d"):
        succeed("relight", tmp_path / f"{name}.h5", tmp_path / f"{name}.exr", "--light", "0.6,0,0.8")
    np.testing.assert_allclose(read_picture(tmp_path / "e.exr"), read_picture(tmp_path / "d.exr"), atol=1e-4)


def test_a_light_below_the_horizon_is_noted(fitted, tmp_path):
    ended = call("relight", fitted, tmp_path / "a.png", "--light", "0,0,-1")
    assert ended.code == 0
    assert ended.err == "note: light 0 is below the horizon, where a hemispherical fit knows nothing\n"


def test_the_same_command_gives_the_same_bytes(tmp_path):
    # The first three also in a process of their own, where nothing is left over from an earlier command.
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        for number, line in enumerate(
            (
                "synth ring ring.h5 --size 16 --lights 36 --pattern scattered --seed 3 --dtype float16",
                "fit ring.h5 fit.h5 --degree 4 --method ceb --holdout 4",
                "encode fit.h5 uniform.h5 --codec uniform",
                "encode fit.h5 wavelet.h5 --codec wavelet --rate 1",
                "encode fit.h5 klt.h5 --codec klt",
                "decode klt.h5 decoded.h5",
                "relight klt.h5 a.png --light 0,0,1",
            )
        ):
            if name == "a" and number < 3:
                ended = process(*line.split(), folder=folder)
            else:
                ended = call(*[folder / word if word.endswith((".h5", ".png")) else word for word in line.split()])
            assert ended.code == 0
            assert ended.err == "" or (line.startswith("fit") and "--holdout-by place" in ended.err)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert len(contents(tmp_path / "a")) == 7


def test_bench_and_report(ring, tmp_path):
    words = ["--methods", "uls,cls", "--degrees", 2, "--codecs", "none,s3tc,uniform", "--holdout", 5]
    told = succeed("bench", ring, "--out", tmp_path / "r.h5", *words, "--json").json
    assert [(row["method"], row["codec"]) for row in told["rows"]] == [
        (method, codec) for method in ("uls", "cls") for codec in ("none", "s3tc", "uniform")
    ]
    for row in told["rows"]:
        fit, enc = tmp_path / "f.h5", tmp_path / "e.h5"
        alone = succeed("fit", ring, fit, "--method", row["method"], "--degree", 2, "--holdout", 5, "--json").json
        if row["codec"] != "none":
            alone = succeed("encode", fit, enc, "--codec", row["codec"], "--stack", ring, "--json").json
            assert row["encoded_bytes"] == alone["encoded_bytes"]
            assert row["bits_per_coefficient"] == alone["bits_per_coefficient"]
        for name, place in (("mean", "psnr_mean"), ("pooled", "psnr_pooled")):
            np.testing.assert_allclose(row[place], alone["psnr"][f"{name}_fitted"], atol=1e-6)
            np.testing.assert_allclose(row[f"{place}_holdout"], alone["psnr"][f"{name}_holdout"], atol=1e-6)
        energy = (arrays(fit)["coefficients"].astype(np.float64) ** 2).sum(axis=0).mean()
        np.testing.assert_allclose(row["mean_energy"], energy, rtol=1e-6)
        assert min(row[name] for name in row if name.startswith("seconds")) >= 0
    printed = call("bench", ring, "--out", tmp_path / "r.h5", *words)
    assert (printed.code, len(printed.err.splitlines())) == (0, 1)
    assert "held out" in printed.err
    text = printed.out
    assert f"{told['rows'][0]['psnr_mean']:.2f}" in text
    assert "held out, pooled (dB)" in text
    files = succeed("report", tmp_path / "r.h5", "--out", tmp_path / "report", "--json").json["files"]
    assert all((tmp_path / "report").joinpath(file).stat().st_size > 0 for file in files)
    page = (tmp_path / "report" / "report.md").read_text()
    assert f"{told['rows'][0]['psnr_mean']:.2f}" in page


@pytest.mark.parametrize("name", sorted(cli.commands))
def test_help_of_every_command_has_an_example(name):
    words = [name, "ring"] if name == "synth" else [name]
    text = succeed(*words, "--help").out
    assert text.startswith(f"Usage: clrelight {' '.join(words)}")
    assert re.search(rf"Example:\n    clrelight {name}\b", text)


def test_help_names_every_method_and_codec():
    fit, encode = succeed("fit", "--help").out, succeed("encode", "--help").out
    assert [method for method in method_ids() if method not in fit] == []
    assert [codec for codec in codec_ids() if codec not in encode] == []


def test_no_command_shows_the_help():
    assert succeed().out == succeed("--help").out
    assert "ring" in succeed("synth").out
    assert succeed("--version").out.startswith("clrelight ")


def test_devices():
    found = succeed("devices", "--json").json["devices"]
    assert sum(device["default"] for device in found) == 1
    assert found[0]["name"] in succeed("devices").out
