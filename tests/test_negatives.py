import h5py
import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.negatives import Negatives
from tests.commands import call

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_tiny_values_become_zero_and_are_counted(dtype):
    values = RNG.random((2, 6, 5, 3)).astype(dtype)
    values[1, 2:4, 3, 1] = -1e-4, -2e-4
    values[0, 0, 0, 0] = -0.0
    negatives = Negatives()
    for i in range(2):
        found = [negatives.clip(values[i, row : row + 2], i, f"image {i}", row) for row in (0, 2, 4)]
        np.testing.assert_array_equal(np.concatenate(found), np.maximum(values[i], 0))
        assert {band.dtype for band in found} == {np.dtype(dtype)}
    assert negatives.conclude(1.0) == ["2 negative values in 1 of 2 images are set to 0; the least is -0.0002"]
    assert Negatives().conclude(1.0) == []


@pytest.mark.parametrize(
    ("least", "scale", "bright", "good"),
    [
        (-9e-4, 1, 1.0, True),
        (-1.1e-3, 1, 1.0, False),
        (-9e-6, 0.01, 1.0, True),
        (-1.1e-5, 0.01, 1.0, False),  # dark pictures have less that is tiny
        (-1.1e-3, 1000, 1.0, False),  # bright spots do not make it more
        (-0.9, 1000, 1000.0, True),
    ],
)
def test_what_is_tiny(least, scale, bright, good):
    values = (RNG.random((4, 5, 1)) * 0.5 + 0.5).astype(np.float32) * np.float32(scale)
    values[0, 0], values[3, 2] = scale, least
    for allowed in (False, True):
        negatives = Negatives(allowed)
        negatives.clip(values, 0, "image a", 10, 20)
        if good or allowed:
            assert len(negatives.conclude(bright)) == 1
        else:
            with pytest.raises(
                InputError, match=r"^image a has radiance .* at row 13, column 22, channel 0; expected a"
            ):
                negatives.conclude(bright)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_never_set_to_zero(value):
    values = np.ones((4, 5, 3), np.float32)
    values[1, 2, 0], values[3, 2, 1] = -1e-9, value
    with pytest.raises(InputError, match=rf"radiance {value} at row 3, column 2, channel 1; expected a finite number"):
        Negatives(allowed=True).clip(values, 0, "image a")


@pytest.mark.parametrize("memory", ["1MiB", "2000"])
def test_ingest_and_the_map_of_a_light(tmp_path, memory):
    (tmp_path / "a").mkdir()
    images = RNG.random((3, 8, 16, 3)).astype(np.float32)
    np.savetxt(tmp_path / "a" / "light_directions.txt", [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]])
    for least, code in ((-2e-4, 0), (-0.25, 2)):
        images[1, 3, 4, 2] = least
        for i, image in enumerate(images):
            write_image(tmp_path / "a" / f"{i}.exr", image)
        out = tmp_path / f"{code}.h5"
        found = call("ingest", tmp_path / "a", out, "--memory", memory)
        light = call("light", tmp_path / f"{code}l.h5", "--env", tmp_path / "a" / "1.exr", "--degree", 1)
        assert (found.code, light.code, out.exists()) == (code, code, code == 0)
        for ended in (found, light):
            if code:
                assert (
                    "1.exr has radiance -0.25 at row 3, column 4, channel 2; expected a finite number >= 0" in ended.err
                )
                assert "(--clip-negative sets such values to 0)" in ended.err
                assert ended.err.count("\n") == 1
            else:
                assert "set to 0; the least is -0.0002" in ended.err
    asked = call("ingest", tmp_path / "a", tmp_path / "asked.h5", "--memory", memory, "--clip-negative", "--json")
    assert "1 negative values in 1 of 3 images are set to 0; the least is -0.25" in asked.json["notes"]
    for name in ("0.h5", "asked.h5"):
        with h5py.File(tmp_path / name) as file:
            np.testing.assert_array_equal(file["images"][()], np.maximum(images, 0))
    map_of = ("light", tmp_path / "l.h5", "--env", tmp_path / "a" / "1.exr", "--degree", 1, "--clip-negative", "--json")
    assert "1.exr: 1 negative values are set to 0; the least is -0.25" in call(*map_of).json["notes"]
