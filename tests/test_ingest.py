import os
import sys
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

from clrelight.errors import InputError
from clrelight.image_header import ImageHeader
from clrelight.images import write_image
from clrelight.ingest import ingest_folder, photographs
from clrelight.ingest.filling import plan_memory
from clrelight.store import check_output
from clrelight.tiles import Rectangle

ingest = sys.modules[ingest_folder.__module__]
RNG = np.random.default_rng(11)
DIRECTIONS = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -0.6, 0.8], [0, 0.8, 0.6], [-0.8, 0, 0.6]])


class Recorder:
    """An array that is filled by slices and remembers each write."""

    def __init__(self, shape, dtype, chunk_lights):
        self.chunks = (min(chunk_lights, 3), 4, *shape[2:])
        self.values = np.zeros(shape, dtype)
        self.filled = np.zeros(shape[:2], int)
        self.writes = []

    def __setitem__(self, key, block):
        assert block.dtype == self.values.dtype
        assert block.shape == self.values[key].shape
        self.values[key] = block
        self.filled[key[:2]] += 1
        self.writes.append(block.nbytes)


@pytest.fixture
def written(monkeypatch):
    """Stand in for the store: what the last ingest gave it; `images` is set only if it ended well."""
    last = SimpleNamespace(images=None, settings=None, began=False)

    @contextmanager
    def create_stack(path, stack, *, chunk_lights):
        last.began = True
        recorder = last.recorder = Recorder(stack.images_ihwc.shape, stack.images_ihwc.dtype, chunk_lights)
        yield recorder
        assert np.all(recorder.filled == 1)
        last.images, last.settings = (
            recorder.values,
            SimpleNamespace(path=path, chunk_lights=chunk_lights, **vars(stack)),
        )

    monkeypatch.setitem(
        sys.modules, "clrelight.store", SimpleNamespace(create_stack=create_stack, check_output=check_output)
    )
    return last


def make_folder(folder, images_ihwc, extension=".png", directions=DIRECTIONS):
    folder.mkdir(exist_ok=True)
    lines = [str(len(images_ihwc))]
    for i, (image, direction) in enumerate(zip(images_ihwc, directions, strict=False)):
        write_image(folder / f"im {i}{extension}", image)
        lines.append(f"im {i}{extension} " + " ".join(map(repr, map(float, direction))))
    (folder / "dirs.lp").write_text("\n".join(lines))
    return folder


def random_images(dtype=np.uint8, shape=(5, 13, 9, 3)):
    top = np.iinfo(dtype).max + 1 if np.dtype(dtype).kind == "u" else 3
    return (RNG.random(shape) * top).astype(dtype)


@pytest.mark.parametrize(
    ("dtype", "extension", "peak"),
    [
        (np.uint8, ".png", 255.0),
        (np.uint16, ".tif", 65535.0),
        (np.float16, ".exr", 1.0),
        (np.float32, ".exr", 1.0),
    ],
)
@pytest.mark.parametrize("channel", [1, 3])
def test_every_type_keeps_its_values(tmp_path, written, dtype, extension, peak, channel):
    images = random_images(dtype, (5, 13, 9, channel))
    folder = make_folder(tmp_path / "lion", images, extension)
    steps = []
    summary = ingest_folder(folder, tmp_path / "out.h5", progress=lambda *step: steps.append(step))
    assert written.images.dtype == dtype
    np.testing.assert_array_equal(written.images, images)
    np.testing.assert_allclose(written.settings.directions_i3, DIRECTIONS, atol=1e-15)
    settings = written.settings
    assert (settings.peak, settings.transfer, settings.name, settings.weights_i) == (peak, "linear", "lion", None)
    assert settings.mask_hw is None
    assert settings.path == tmp_path / "out.h5"
    assert steps == [(i, 5) for i in range(1, 6)]
    assert (summary.n_light, summary.image_shape, summary.dtype) == (5, (13, 9, channel), np.dtype(dtype).name)
    assert (summary.duplicates, summary.below_horizon, summary.peak) == (0, 0, peak)
    np.testing.assert_allclose(summary.elevation_range, (np.degrees(np.arcsin(0.6)), 90))


def test_crop_mask_subset_and_names(tmp_path, written):
    images = random_images()
    folder = make_folder(tmp_path / "a", images, directions=DIRECTIONS * 2)
    mask = np.zeros((13, 9, 3), np.uint8)
    mask[4:8, 3:5, 1] = 1
    write_image(tmp_path / "m.png", mask)
    options = {"crop": (2, 3, 4, 6), "mask": tmp_path / "m.png", "subset": "-1,0:2", "name": "b", "peak": 200}
    summary = ingest_folder(folder, tmp_path / "o.h5", transfer="srgb", **options)
    np.testing.assert_array_equal(written.images, images[[4, 0, 1], 3:9, 2:6])
    np.testing.assert_array_equal(written.settings.mask_hw, mask[3:9, 2:6, 1] > 0)
    np.testing.assert_allclose(written.settings.directions_i3, DIRECTIONS[[4, 0, 1]], atol=1e-15)
    assert (written.settings.name, written.settings.peak, written.settings.transfer) == ("b", 200.0, "srgb")
    assert any("3 directions were not of unit length" in note for note in summary.notes)


def test_duplicates_and_lights_below_are_counted(tmp_path, written):
    directions = np.array([[0, 0, 1], [0, 0, 1], [0, 0.6, -0.8], [0, 0, 2], [1, 0, 0]])
    folder = make_folder(tmp_path / "a", random_images(), directions=directions)
    with pytest.raises(InputError, match=r"light 2 \(im 2.png\) .*below the horizon"):
        ingest_folder(folder, tmp_path / "o.h5")
    summary = ingest_folder(folder, tmp_path / "o.h5", allow_below=True)
    assert (summary.duplicates, summary.below_horizon) == (2, 1)
    assert ingest_folder(folder, tmp_path / "o.h5", subset="0:2").below_horizon == 0


def test_light_just_below_the_horizon_is_put_on_it(tmp_path, written):
    directions = DIRECTIONS.copy()
    directions[3] = [0, 1, -np.sin(np.radians(0.1))]
    folder = make_folder(tmp_path / "a", random_images(), directions=directions)
    summary = ingest_folder(folder, tmp_path / "o.h5")
    np.testing.assert_allclose(written.settings.directions_i3[3], [0, 1, 0], atol=1e-15)
    assert summary.below_horizon == 0
    assert any("im 3.png" in note and "0.1° below the horizon" in note for note in summary.notes)
    ingest_folder(folder, tmp_path / "o.h5", allow_below=True)
    assert written.settings.directions_i3[3, 2] < -1e-3


@pytest.mark.parametrize(("dtype", "extension", "white"), [(np.uint8, ".png", 255), (np.uint16, ".tif", 4095)])
@pytest.mark.parametrize("memory", [1 << 20, 3000])
def test_black_and_white_images_are_named(tmp_path, written, dtype, extension, white, memory):
    images = random_images(dtype) % white
    images[[1, 3]] = 0
    images[4] = white
    folder = make_folder(tmp_path / "a", images, extension)
    options = {"memory_bytes": memory, "peak": white}
    subset = "; --subset 0:1,2:3 leaves them out"
    notes = ingest_folder(folder, tmp_path / "o.h5", **options).notes
    black, bright = (next(note for note in notes if word in note) for word in ("black", "white"))
    assert black == f"2 images are wholly black (did the light fail?): im 1{extension}, im 3{extension}{subset}"
    assert bright == f"1 image is wholly white (is it overexposed?): im 4{extension}{subset}"
    np.testing.assert_array_equal(written.images, images)
    assert not ingest_folder(folder, tmp_path / "o.h5", subset="0:1,2:3", **options).notes
    write_image(folder / f"im 3{extension}", np.eye(13, 9, dtype=dtype)[..., None].repeat(3, 2))
    notes = ingest_folder(folder, tmp_path / "o.h5", crop=(0, 1, 9, 12), subset="3,1", **options).notes
    assert notes == (f"1 image is wholly black (did the light fail?): im 1{extension}; --subset 3:4 leaves them out",)


@pytest.mark.parametrize("memory", [1 << 20, 3000])
def test_images_are_black_or_white_where_the_mask_is(tmp_path, written, memory):
    images = np.maximum(random_images(), 1)
    mask = np.zeros((13, 9), np.uint8)
    mask[3:6, 2:7] = mask[12, 8] = 255
    images[0, mask > 0] = 0
    images[2, mask > 0] = 255
    images[3, mask > 0] = 0
    images[3, 12, 8, 1] = 1
    folder = make_folder(tmp_path / "a", images)
    write_image(tmp_path / "m.png", mask)
    notes = ingest_folder(folder, tmp_path / "o.h5", mask=tmp_path / "m.png", memory_bytes=memory).notes
    assert [note.split(";")[0] for note in notes if "wholly" in note] == [
        "1 image is wholly black (did the light fail?): im 0.png",
        "1 image is wholly white (is it overexposed?): im 2.png",
    ]
    assert not any("wholly" in note for note in ingest_folder(folder, tmp_path / "o.h5").notes)


def test_stack_that_is_black_altogether(tmp_path, written):
    folder = make_folder(tmp_path / "a", np.zeros((5, 13, 9, 3), np.float32), ".exr")
    notes = ingest_folder(folder, tmp_path / "o.h5").notes
    assert notes == (
        "5 images are wholly black (did the light fail?): im 0.exr, im 1.exr, im 2.exr, im 3.exr, im 4.exr",
    )
    folder = make_folder(tmp_path / "b", np.full((5, 13, 9, 3), 7, np.float32), ".exr")
    assert ingest_folder(folder, tmp_path / "o.h5").notes == ()  # above 1 is no clipping where floats are kept


def make_diligent(folder, images_ihwc, intensities_ic, extension=".png"):
    make_folder(folder, images_ihwc, extension)
    (folder / "dirs.lp").unlink()
    (folder / "filenames.txt").write_text("".join(f"im {i}{extension}\n" for i in range(len(images_ihwc))))
    np.savetxt(folder / "light_directions.txt", DIRECTIONS[: len(images_ihwc)])
    np.savetxt(folder / "light_intensities.txt", intensities_ic, fmt="%.17g")
    write_image(folder / "mask.png", np.eye(13, 9, dtype=np.uint8) * 255)
    return folder


@pytest.mark.parametrize(
    ("dtype", "extension", "stored", "precision"),
    [
        (np.uint8, ".png", np.float16, 2.0**-11),
        (np.uint16, ".png", np.float32, 1e-6),
        (np.float16, ".exr", np.float32, 1e-6),
    ],
)
@pytest.mark.parametrize("memory", [1 << 20, 3000])
def test_light_intensities_are_divided_out(tmp_path, written, dtype, extension, stored, precision, memory):
    images = random_images(dtype)
    intensities = RNG.uniform(0.3, 3.0, (5, 3))
    folder = make_diligent(tmp_path / "cat", images, intensities, extension)
    summary = ingest_folder(folder, tmp_path / "o.h5", memory_bytes=memory)
    code_peak = {np.uint8: 255, np.uint16: 65535, np.float16: 1}[dtype]
    expected = images / code_peak * intensities.mean() / intensities[:, None, None]
    assert written.images.dtype == stored
    np.testing.assert_allclose(written.images.astype(float), expected, rtol=precision)
    assert (summary.peak, written.settings.peak) == (1.0, 1.0)
    assert written.images.max() > 1  # white under a dim light is not clipped
    np.testing.assert_array_equal(written.settings.mask_hw, np.eye(13, 9) > 0)


def test_division_is_the_same_for_a_subset_and_can_be_left_out(tmp_path, written):
    images, intensities = random_images(), RNG.uniform(0.3, 3.0, (5, 3))
    folder = make_diligent(tmp_path / "cat", images, intensities)
    ingest_folder(folder, tmp_path / "o.h5")
    whole = written.images
    ingest_folder(folder, tmp_path / "o.h5", subset="3,1")
    np.testing.assert_array_equal(written.images, whole[[3, 1]])
    assert written.settings.peak == 1
    ingest_folder(folder, tmp_path / "o.h5", divide_intensities=False)
    np.testing.assert_array_equal(written.images, images)
    assert written.settings.peak == 255
    with pytest.raises(InputError, match="linear values only"):
        ingest_folder(folder, tmp_path / "o.h5", transfer="srgb")


def test_intensities_too_far_apart_for_half_precision(tmp_path, written):
    images, intensities = random_images(), np.ones((5, 3))
    intensities[0, 0] = 1e6
    folder = make_diligent(tmp_path / "cat", images, intensities)
    assert ingest_folder(folder, tmp_path / "o.h5").dtype == "float32"
    np.testing.assert_allclose(written.images[0, ..., 0], images[0, ..., 0] / 255 * intensities.mean() / 1e6, rtol=1e-6)


def test_colour_intensities_of_gray_images(tmp_path, written):
    folder = make_diligent(tmp_path / "a", random_images(shape=(5, 13, 9, 1)), np.ones((5, 3)))
    with pytest.raises(InputError, match="3 intensities a light, but images have 1 channel"):
        ingest_folder(folder, tmp_path / "o.h5")
    np.savetxt(folder / "light_intensities.txt", np.ones(5))
    assert ingest_folder(folder, tmp_path / "o.h5").peak == 1.0


def write_exr(path, values_hwc, tile):
    spec = oiio.ImageSpec(values_hwc.shape[1], values_hwc.shape[0], values_hwc.shape[2], oiio.FLOAT)
    spec.tile_width, spec.tile_height = tile
    writer = oiio.ImageOutput.create(str(path))
    assert writer.open(str(path), spec)
    assert writer.write_image(values_hwc)
    assert writer.close()


@pytest.mark.parametrize("kind", ["png", "tiled.exr", "divided"])
@pytest.mark.parametrize("crop", [None, (3, 5, 40, 61)])
@pytest.mark.parametrize("images_held", [0.4, 1.7, 2.5, 3.5, 7.5, 100])
def test_memory_stays_within_the_budget(tmp_path, written, monkeypatch, kind, crop, images_held):
    images = random_images(np.float32 if kind == "tiled.exr" else np.uint8, (7, 70, 50, 3))
    lights = np.tile(DIRECTIONS, (2, 1))[:7]
    if kind == "divided":
        folder = make_folder(tmp_path / "a", images, directions=lights)
        (folder / "filenames.txt").write_text("".join(f"im {i}.png\n" for i in range(7)))
        np.savetxt(folder / "light_directions.txt", lights)
        np.savetxt(folder / "light_intensities.txt", np.ones((7, 3)))
    else:
        folder = make_folder(tmp_path / "a", images, ".exr" if kind == "tiled.exr" else ".png", lights)
    if kind == "tiled.exr":
        for i, image in enumerate(images):
            write_exr(folder / f"im {i}.exr", image, (16, 4))
    x, y, width, height = crop or (0, 0, 50, 70)
    stored = 2 if kind == "divided" else images.itemsize
    budget = int(images_held * width * height * 3 * stored)
    opened, bands = [], []

    def counting(header, rows, band_bytes):
        opened.append(header.path.name)
        for row, band in read_bands(header, rows, band_bytes):
            bands.append(band.nbytes)
            yield row, band

    read_bands = photographs.read_bands
    monkeypatch.setattr(photographs, "read_bands", counting)
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    ingest_folder(folder, tmp_path / "o.h5", crop=crop, memory_bytes=budget)
    expected = images[:, y : y + height, x : x + width]
    if kind == "divided":
        np.testing.assert_allclose(written.images.astype(float), expected / 255, rtol=2.0**-11)
    else:
        np.testing.assert_array_equal(written.images, expected)
    assert sorted(opened) == sorted(p.name for p in folder.glob("im *"))
    # Every band as read, as float32 where divided, and as written, twice, in each of the threads; and the block.
    copies = 2 * (images.itemsize + (4 if kind == "divided" else 0) + stored) / images.itemsize
    block = written.settings.chunk_lights * width * height * 3 * stored
    if max(written.recorder.writes) < width * height * 3 * stored:
        assert written.settings.chunk_lights == 1
        assert copies * max(bands) <= budget
    else:
        assert written.recorder.writes[0] >= block * 3 / 5  # whole chunks of 3 lights
        assert max(written.recorder.writes) <= block
        assert copies * max(bands) + block <= budget
        if images_held == 100:
            assert written.settings.chunk_lights == 7


def test_plan_counts_every_thread(tmp_path, monkeypatch):
    header = ImageHeader(tmp_path, 8192, 8192, 3, np.dtype(np.uint8), (0, 0), 1)
    window = Rectangle(0, 0, 8192, 8192)
    source = photographs.Photographs([header] * 200, window, photographs.Values(np.dtype(np.uint8), 255.0))
    for cores in (1, 4, 64, 500):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        for budget in (1 << 17, 1 << 24, 1 << 30, 3 << 30, 1 << 37):
            plan = plan_memory(source, budget)
            assert 1 <= plan.workers <= min(cores, 200)
            assert plan.band_bytes >= header.row_bytes
            assert 4 * plan.workers * plan.band_bytes + plan.n_held * 8192 * 8192 * 3 <= budget
    assert plan_memory(source, 1 << 30).n_held >= 3
    assert plan_memory(source, 1 << 37).n_held == 200
    with pytest.raises(InputError, match="expected at least 98304"):
        plan_memory(source, 98303)


def test_blocks_are_of_nearly_equal_size(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    header = ImageHeader(tmp_path, 1000, 1000, 1, np.dtype(np.uint8), (0, 0), 1)
    source = photographs.Photographs(
        [header] * 21, Rectangle(0, 0, 1000, 1000), photographs.Values(np.dtype(np.uint8), 255.0)
    )
    assert plan_memory(source, 27_000_000).n_held == 11


def test_bad_images_are_named_before_anything_is_decoded(tmp_path, written, monkeypatch):
    images = random_images()
    folder = make_folder(tmp_path / "a", images)
    monkeypatch.setattr(photographs, "read_bands", None)

    def attempt(name, values, message):
        old = (folder / name).read_bytes()
        write_image(folder / name, values)
        with pytest.raises(InputError, match=message) as error:
            ingest_folder(folder, tmp_path / "o.h5")
        (folder / name).write_bytes(old)
        assert name in str(error.value)

    attempt("im 3.png", images[3, 1:], "has pixels 9×12, but im 0.png 9×13")
    attempt("im 2.png", images[2, ..., :1], "has channels 1, but im 0.png 3")
    attempt("im 4.png", images[4].astype(np.uint16), "has values uint16, but im 0.png uint8")
    (folder / "im 1.png").unlink()
    with pytest.raises(InputError, match=r"im 1.png"):
        ingest_folder(folder, tmp_path / "o.h5")
    assert not written.began


def test_shifted_data_window_is_refused(tmp_path, written):
    folder = make_folder(tmp_path / "a", random_images(np.float32), ".exr")
    spec = oiio.ImageSpec(9, 13, 3, oiio.FLOAT)
    spec.x = 1
    writer = oiio.ImageOutput.create("x.exr")
    assert writer.open(str(folder / "im 2.exr"), spec)
    assert writer.write_image(np.ones((13, 9, 3), np.float32))
    assert writer.close()
    with pytest.raises(InputError, match=r"im 2.exr has data window at \(1, 0\), but im 0.exr \(0, 0\)"):
        ingest_folder(folder, tmp_path / "o.h5")


@pytest.mark.parametrize("memory", [1 << 20, 1500])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -0.01])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_bad_radiance_is_named(tmp_path, written, bad, dtype, memory):
    images = random_images(dtype)
    images[3, 7, 5, 2] = bad
    folder = make_folder(tmp_path / "a", images, ".exr")
    place = r"im 3.exr has radiance .* at row 7, column 5, channel 2"
    for crop in (None, (4, 6, 3, 3)):
        with pytest.raises(InputError, match=place):
            ingest_folder(folder, tmp_path / "o.h5", crop=crop, memory_bytes=memory)
    assert written.images is None
    ingest_folder(folder, tmp_path / "o.h5", crop=(0, 0, 5, 13), memory_bytes=memory)
    np.testing.assert_array_equal(written.images, images[:, :, :5])


def test_damaged_image_leaves_nothing(tmp_path, written):
    folder = make_folder(tmp_path / "a", random_images(), ".jpg")
    content = (folder / "im 2.jpg").read_bytes()
    (folder / "im 2.jpg").write_bytes(content[:-100])
    with pytest.raises(InputError, match=r"im 2.jpg.*Premature end"):
        ingest_folder(folder, tmp_path / "o.h5")
    assert written.began
    assert written.images is None


def test_other_bad_input(tmp_path, written):
    folder = make_folder(tmp_path / "a", random_images())
    write_image(tmp_path / "small.png", np.ones((13, 8), np.uint8))
    write_image(tmp_path / "zero.png", np.zeros((13, 9), np.uint8))
    for options, message in (
        ({"transfer": "gamma"}, "transfer must be one of linear, srgb"),
        ({"peak": 0}, "peak must be a positive number"),
        ({"peak": float("nan")}, "peak must be a positive number"),
        ({"crop": (0, 0, 10, 13)}, "crop x=0 y=0 width=10 height=13 .* 9×13"),
        ({"crop": (-1, 0, 3, 3)}, "crop x=-1"),
        ({"crop": (0, 12, 3, 2)}, "crop x=0 y=12"),
        ({"crop": (0, 0, 0, 3)}, "is empty"),
        ({"mask": tmp_path / "small.png"}, "small.png has 8×13 pixels, but the images 9×13"),
        ({"mask": tmp_path / "zero.png"}, "zero.png is zero everywhere"),
        ({"mask": tmp_path / "none.png"}, "no image .*none.png"),
        ({"subset": "7"}, "no light 7"),
        ({"subset": "3:3"}, "chooses none"),
        ({"lights": tmp_path / "none.lp"}, "no light file"),
        ({"memory_bytes": 10}, "cannot hold 1 row"),
    ):
        with pytest.raises(InputError, match=message) as error:
            ingest_folder(folder, tmp_path / "o.h5", **options)
        assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="no folder"):
        ingest_folder(tmp_path / "none", tmp_path / "o.h5")
    assert not written.began


@pytest.mark.parametrize("name", ["im 2.png", "dirs.lp", "mask.png"])
def test_result_does_not_replace_what_is_read(tmp_path, written, name):
    folder = make_folder(tmp_path / "a", random_images())
    write_image(folder / "mask.png", np.ones((13, 9), np.uint8))
    (tmp_path / "link.h5").hardlink_to(folder / name)
    with pytest.raises(InputError, match=rf"that is the input .*{name}"):
        ingest_folder(folder, tmp_path / "link.h5", mask=folder / "mask.png")
    assert not written.began


def test_error_in_progress_stops_the_decoders(tmp_path, written):
    folder = make_folder(tmp_path / "a", random_images())

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ingest_folder(folder, tmp_path / "o.h5", progress=interrupt)
    assert written.images is None


def pillow(path):
    with Image.open(path) as file:
        values = np.asarray(file)
    return values.reshape(*values.shape[:2], -1)[..., :3]


def test_loewenkopf(real_data, tmp_path, written):
    folder = real_data / "stacks" / "loewenkopf"
    summary = ingest_folder(folder, tmp_path / "o.h5", transfer="srgb")
    lines = [line.split() for line in (folder / "dirs.lp").read_text().split("\n")[1:] if line]
    assert written.images.shape == (240, 43, 64, 3)
    np.testing.assert_allclose(written.settings.directions_i3, [[float(v) for v in p[1:]] for p in lines], atol=1e-6)
    for i in (0, 100, 239):
        assert np.abs(written.images[i].astype(int) - pillow(folder / lines[i][0])).max() <= 1
    np.testing.assert_allclose(summary.elevation_range, (1.3, 83), atol=0.1)


@pytest.mark.parametrize("name", ["catPNG", "bearPNG", "pot1PNG"])
def test_diligent(real_data, tmp_path, written, name):
    folder = real_data / "stacks" / "diligent" / name
    summary = ingest_folder(folder, tmp_path / "o.h5")
    intensities = np.loadtxt(folder / "light_intensities.txt")
    np.testing.assert_allclose(written.settings.directions_i3, np.loadtxt(folder / "light_directions.txt"), atol=1e-4)
    np.testing.assert_array_equal(written.settings.mask_hw, pillow(folder / "mask.png").any(axis=2))
    for i in (0, 50, 95):
        expected = pillow(folder / f"{i + 1:03d}.png") / 255 * intensities.mean() / intensities[i]
        np.testing.assert_allclose(written.images[i].astype(float), expected, rtol=2.0**-11)
    assert (summary.n_light, summary.peak) == (96, 1.0)


def test_psbox_cat(real_data, tmp_path, written):
    folder = real_data / "stacks" / "psbox_cat"
    ingest_folder(folder, tmp_path / "o.h5")
    assert written.images.shape == (12, 550, 430, 1)
    np.testing.assert_allclose(
        written.settings.directions_i3, np.loadtxt(folder / "light_directions.txt").T, atol=1e-12
    )
    for i in range(12):
        np.testing.assert_array_equal(written.images[i], pillow(folder / f"Image_{i + 1:02d}.png"))


def test_realrti_lists_one_light_too_many(real_data, tmp_path, written):
    folder = real_data / "stacks" / "realrti" / "item12"
    summary = ingest_folder(folder, tmp_path / "o.h5", crop=(0, 0, 8, 8))
    lines = [line.split() for line in (folder / "dirs.lp").read_text().splitlines()[1:48]]
    expected = np.array([[float(v) for v in line[1:]] for line in lines])
    np.testing.assert_allclose(written.settings.directions_i3, expected, atol=1e-6)
    assert "dirs.lp announces 47 lights, but lists 48; the first 47 were taken" in summary.notes


def test_univr_dome(real_data, tmp_path, written):
    folder = real_data / "stacks" / "univr_dome"
    summary = ingest_folder(folder, tmp_path / "o.h5", mask=folder / "mask.png", subset="::7")
    assert written.images.shape == (7, 320, 320, 3)
    assert np.abs(written.images[1].astype(int) - pillow(folder / "image08.jpg")).max() <= 1
    np.testing.assert_array_equal(written.settings.mask_hw, pillow(folder / "mask.png").any(axis=2))
    assert summary.elevation_range[1] <= 90


def test_stack_file_comes_back_from_the_store(tmp_path):
    pytest.importorskip("clrelight.store")
    h5py = pytest.importorskip("h5py")
    images = random_images(shape=(5, 70, 50, 3))
    folder = make_folder(tmp_path / "lion", images)
    for number, memory in enumerate((1 << 20, 30_000, 5_000)):  # at once, in blocks, in bands
        out = tmp_path / f"{number}.h5"
        ingest_folder(folder, out, memory_bytes=memory, crop=(1, 2, 40, 60))
        with h5py.File(out) as file:
            np.testing.assert_array_equal(file["images"], images[:, 2:62, 1:41])
            np.testing.assert_allclose(file["directions"], DIRECTIONS, atol=1e-15)
    (folder / "im 4.png").write_bytes(b"junk")
    with pytest.raises(InputError, match=r"im 4.png"):
        ingest_folder(folder, tmp_path / "bad.h5")
    assert not list(tmp_path.glob("*bad*"))
