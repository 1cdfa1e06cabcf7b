"""Parts of images and lower resolutions, on the command line and from Python."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.images import read_image
from clrelight.store import open_fit, write_stack
from tests.commands import call, succeed


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A stack of 150 x 90 pixels with its fit, coded by klt and by half."""
    folder = tmp_path_factory.mktemp("region")
    rng = np.random.default_rng(5)
    directions = rng.standard_normal((20, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    y, x = np.mgrid[:90, :150]
    normals = np.stack([np.sin(0.07 * x), np.cos(0.09 * y), np.full(x.shape, 1.5)], -1)
    images = np.clip(np.einsum("id,hwd->ihw", directions, normals) * 0.3, 0, 1)[..., None] * [0.9, 0.6, 0.3]
    write_stack(folder / "stack.h5", LightStack(np.rint(255 * images).astype(np.uint8), directions, 255.0, "linear"))
    succeed("fit", folder / "stack.h5", folder / "fit.h5", "--degree", 2)
    succeed("encode", folder / "fit.h5", folder / "klt.h5", "--codec", "klt", "--step", "0.005")
    succeed("encode", folder / "fit.h5", folder / "half.h5", "--codec", "half")
    return folder


@pytest.mark.parametrize("name", ["klt.h5", "half.h5"])
def test_a_region_of_a_file_is_that_part(files, tmp_path, name):
    succeed("decode", files / name, tmp_path / "all.h5")
    succeed("decode", files / name, tmp_path / "part.h5", "--region", "31,17,50,40")
    with open_fit(tmp_path / "all.h5") as whole, open_fit(tmp_path / "part.h5") as part:
        expected = np.asarray(whole.to_float32().coeffs_khwc)[:, 17:57, 31:81]
        np.testing.assert_allclose(np.asarray(part.to_float32().coeffs_khwc), expected, atol=2e-6)
        assert part.directions_i3.shape == whole.directions_i3.shape


@pytest.mark.parametrize("name", ["klt.h5", "half.h5", "fit.h5"])
def test_a_picture_of_a_region_is_that_part(files, tmp_path, name):
    light = ("--light", "0.2,0.3,1")
    succeed("relight", files / name, tmp_path / "all.exr", *light)
    succeed("relight", files / name, tmp_path / "part.exr", *light, "--region", "100,3,50,87")
    whole, part = read_image(tmp_path / "all.exr"), read_image(tmp_path / "part.exr")
    assert part.shape == (87, 50, 3)
    np.testing.assert_allclose(part, whole[3:90, 100:150], atol=1e-5)


def test_a_level_is_the_mean_of_pixels(files):
    light = (0.1, 0.4, 1.0)
    whole = cr.relight(files / "klt.h5", light)
    small = cr.relight(files / "klt.h5", light, level=1)
    assert small.shape == (45, 75, 3)
    means = whole.reshape(45, 2, 75, 2, 3).mean(axis=(1, 3))
    # The 9/7 filter is no box: it looks further, and it is centred on the first of two pixels.
    assert np.abs(small - means).mean() < 0.05 * means.mean()
    part = cr.relight(files / "klt.h5", light, region=(20, 10, 60, 40), level=2)
    np.testing.assert_allclose(part, cr.relight(files / "klt.h5", light, level=2)[2:13, 5:20], atol=1e-5)
    assert cr.decode(files / "klt.h5", level=2).coeffs_khwc.shape == (9, 23, 38, 3)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("decode klt.h5 o.h5 --region 100,0,51,10", "does not lie in an image of 150 x 90 pixels"),
        ("decode klt.h5 o.h5 --region 0,0,0,10", "region must be X,Y,WIDTH,HEIGHT, the last two 1 or more"),
        ("decode klt.h5 o.h5 --region 0,0,5", "expected 4 whole numbers"),
        ("decode klt.h5 o.h5 --level 6", "6 is not in the range"),
        ("decode half.h5 o.h5 --level 1", "an encoding by half holds no levels"),
        ("relight fit.h5 o.png --light 0,0,1 --level 1", "a fit holds no levels"),
        ("relight klt.h5 o.png --light 0,0,1 --region -1,0,5,5", "region must be"),
    ],
)
def test_parts_that_are_none_are_refused(files, monkeypatch, words, told):
    monkeypatch.chdir(files)
    ended = call(*words.split())
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended.err
    assert told in ended.err
    assert not (files / words.split()[2]).exists()


def test_python_says_the_same(files):
    with pytest.raises(InputError, match="level must be 0 to 5, got 7"):
        cr.relight(files / "klt.h5", (0, 0, 1), level=7)
    with pytest.raises(InputError, match="region must be X,Y,WIDTH,HEIGHT"):
        cr.decode(files / "klt.h5", region=(1, 2, 3))
