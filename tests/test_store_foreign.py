"""Stacks that others write: each reads as the plain one does, with a note, or is refused in one line."""

import os
import zlib
from dataclasses import replace

import h5py
import numpy as np
import pytest

from clrelight import store
from clrelight.dataset import LightStack
from clrelight.errors import InputError, StoreFormatError
from clrelight.sampling import make_pattern
from tests.commands import call, succeed
from tests.hdf5 import unseal

N, HEIGHT, WIDTH = 7, 5, 9
DIRECTIONS = make_pattern("uniform", N)
IMAGES = np.random.default_rng(4).integers(0, 256, (N, HEIGHT, WIDTH, 3), np.uint8)
GRAY = IMAGES[..., 0]
MASK = np.random.default_rng(5).random((HEIGHT, WIDTH)) < 0.5


def write(path, images=IMAGES, directions=DIRECTIONS, *, options=None, file_options=None, **changes):
    """Write a stack as h5py's user would; a change to None leaves an attribute out."""
    attributes = {"clrelight_schema": "stack/1", "peak": 255.0, "transfer": "linear", "name": "vase"}
    data = {name: changes.pop(name) for name in ("mask", "weights", "exif") if name in changes}
    with h5py.File(path, "w", **(file_options or {})) as file:
        for name, value in {**attributes, **changes}.items():
            if value is not None:
                file.attrs[name] = value
        file.create_dataset("images", data=images, **(options or {}))
        file["directions"] = directions
        for name, value in data.items():
            file[name] = value
    return path


def check(path, images=IMAGES, *, peak=255.0, note=None, name="vase", mask=None, weights=None):
    """Check that a file reads as these images under `DIRECTIONS`, every way they can be read, with one note or none."""
    with store.open_stack(path) as stack:
        np.testing.assert_array_equal(stack.images_ihwc[...], images, strict=True)
        for first, end in ((0, HEIGHT), (1, 3), (4, 5)):
            out = np.zeros((N, end - first, *images.shape[2:]), images.dtype)
            np.testing.assert_array_equal(stack.read_rows(first, end, out), images[:, first:end], strict=True)
            picked = np.array([5, 0, 3])
            some = stack.select(picked)
            np.testing.assert_array_equal(some.read_rows(first, end, out[:3].copy()), images[picked, first:end])
        np.testing.assert_array_equal(stack.images_ihwc[[1, 3], 2], images[[1, 3], 2])
        np.testing.assert_allclose(stack.directions_i3, DIRECTIONS, atol=1e-7, rtol=0)
        assert np.abs(np.linalg.norm(stack.directions_i3, axis=1) - 1).max() < 1e-15 * 4
        assert (stack.peak, stack.transfer, stack.name) == (peak, "linear", name)
        for found, wanted in ((stack.mask_hw, mask), (stack.weights_i, weights)):
            assert (found is None) == (wanted is None)
            assert wanted is None or (found == wanted).all()
        assert len(stack.notes) == (note is not None), stack.notes
        assert note is None or note in stack.notes[0]
    facts = store.describe(path)
    assert facts["datasets"]["images"]["shape"] == list(images.shape)
    assert facts["attributes"] == {"peak": peak, "transfer": "linear", "name": name}
    assert facts.get("notes", []) == list(stack.notes)


def refuse(path, *phrases):
    with pytest.raises(StoreFormatError) as caught, store.open_stack(path):
        pass
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    assert all(phrase in text for phrase in phrases), text


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"clrelight_schema": np.bytes_("stack/1"), "transfer": np.bytes_("linear"), "name": np.bytes_("vase")},
        {"clrelight_schema": ["stack/1"], "transfer": ["linear"], "name": np.array([b"vase"])},
        {"transfer": "LINEAR"},
        {"peak": np.array([255.0])},
        {"peak": 255},
        {"peak": np.array([[255]], ">i2")},
        {"peak": np.float32(255)},
        {"comment": "unknown", "history": np.arange(5)},
        {"exif": "a text of variable length"},
        {"exif": np.zeros(3, [("a", "f4", (2,))])},
    ],
)
def test_attributes_and_extras_of_h5py(tmp_path, changes):
    check(write(tmp_path / "s.h5", **changes))


def test_extras_are_not_opened(tmp_path):
    path = write(tmp_path / "s.h5")
    with h5py.File(path, "a") as file:
        file.create_dataset("light", data=np.zeros((2, 2)), compression="lzf")  # the name of one of our scales
        file.create_dataset("#refs#", data=file["images"].ref, dtype=h5py.ref_dtype)
        file.create_dataset("far", (9,), "u1", external=[("/dev/zero", 0, 9)])
        file["again"] = file["images"]
        file.create_group("deep/er/and/deeper/and/deeper/and/deeper/and/deeper")["text"] = "x"
        file["type"] = np.dtype("f8")
    check(path)
    with h5py.File(path, "a") as file:
        file["link"] = h5py.SoftLink("/images")
    refuse(path, "link is a soft or external link")


@pytest.mark.parametrize(
    ("images", "found"),
    [
        (IMAGES.astype(">u2"), IMAGES.astype(np.uint16)),
        (IMAGES.astype("<i2"), IMAGES.astype(np.uint16)),
        (IMAGES.astype("<i4"), IMAGES.astype(np.uint16)),
        (IMAGES.astype(">i8"), IMAGES.astype(np.uint16)),
        (IMAGES.astype("<u8"), IMAGES.astype(np.uint16)),
        (IMAGES.astype("<f8"), IMAGES.astype(np.float32)),
        (IMAGES.astype(">f4"), IMAGES.astype(np.float32)),
        (IMAGES.astype(">f2"), IMAGES.astype(np.float16)),
        (GRAY, GRAY[..., None]),
        (GRAY.astype("<f8"), GRAY[..., None].astype(np.float32)),
    ],
)
@pytest.mark.parametrize("options", [{}, {"chunks": True}, {"compression": "gzip", "shuffle": True}])
def test_images_of_other_types(tmp_path, images, found, options):
    check(write(tmp_path / "s.h5", images, options=options), found)


def test_images_of_truth_values(tmp_path):
    path = write(tmp_path / "s.h5", IMAGES > 99, peak=None)
    check(path, (IMAGES > 99).astype(np.uint8), peak=1.0, note="no attribute peak: 1 is taken")


@pytest.mark.parametrize("value", [-1, 65536, 1 << 40])
def test_integers_that_do_not_fit_are_refused_where_they_are_read(tmp_path, value):
    images = IMAGES.astype(np.int64)
    images[3, 4, 2, 1] = value
    path = write(tmp_path / "s.h5", images)
    with store.open_stack(path) as stack:
        stack.read_rows(0, 4)
        with pytest.raises(InputError, match=f"int64 from .*{value}.*integers must be from 0 to 65535"):
            stack.read_rows(3, 5)
    ended = call("fit", path, tmp_path / "f.h5", "--degree", 1)
    assert (ended.code, ended.out, os.listdir(tmp_path)) == (2, "", ["s.h5"])


@pytest.mark.parametrize(
    ("changes", "note", "read"),
    [
        ({"name": None}, "no attribute name: taken as s", {"name": "s"}),
        ({"transfer": None}, "no attribute transfer: taken as linear", {}),
        ({"peak": None}, "no attribute peak: 255 is taken as the value that means 1.0", {}),
        ({"peak": None, "images": IMAGES.astype(">u2")}, "65535 is taken", {"peak": 65535.0}),
        ({"peak": None, "images": IMAGES.astype("<i2")}, "32767 is taken", {"peak": 32767.0}),
        ({"peak": None, "images": IMAGES / 255.0}, "1 is taken", {"peak": 1.0}),
    ],
)
def test_what_is_left_out_is_noted(tmp_path, changes, note, read):
    path = write(tmp_path / "s.h5", **changes)
    images = changes.get("images", IMAGES)
    kinds = {"u": np.uint8 if images.itemsize == 1 else np.uint16, "i": np.uint16, "f": np.float32}
    check(path, images.astype(kinds[images.dtype.kind]), note=note, **read)


def test_wide_integers_need_a_peak(tmp_path):
    refuse(write(tmp_path / "s.h5", IMAGES.astype(int), peak=None), "int64", "no attribute peak", "f.attrs['peak'] = ")


def test_srgb_in_any_case(tmp_path):
    for text in ("sRGB", "SRGB", "srgb"):
        with store.open_stack(write(tmp_path / "s.h5", transfer=text)) as stack:
            assert stack.transfer == "srgb"
    refuse(write(tmp_path / "s.h5", transfer="gamma"), "transfer must be one of linear, srgb")


@pytest.mark.parametrize(
    ("directions", "note"),
    [
        (DIRECTIONS.astype("<f4"), None),
        (DIRECTIONS.astype(">f8"), None),
        (DIRECTIONS.T, None),
        (DIRECTIONS * 1.009, "off by up to 0.9%"),
        (DIRECTIONS.T.astype("f4") * np.float32(0.995), "off by up to 0.5%"),
    ],
)
def test_directions(tmp_path, directions, note):
    check(write(tmp_path / "s.h5", directions=directions), note=note)


def test_integer_directions(tmp_path):
    axes = np.array([[0, 0, 1], [1, 0, 0], [0, -1, 0]], np.int8)
    with store.open_stack(write(tmp_path / "s.h5", IMAGES[:3], axes)) as stack:
        np.testing.assert_array_equal(stack.directions_i3, axes.astype(np.float64), strict=True)


@pytest.mark.parametrize(
    ("directions", "phrase"),
    [
        (DIRECTIONS * 1.011, "no finite unit vector"),
        (DIRECTIONS * 500, "no finite unit vector"),
        (DIRECTIONS[:, :2], "expected numbers N×3"),
        (DIRECTIONS[:-1], "as many images as directions"),
        (DIRECTIONS.ravel(), "expected numbers N×3"),
    ],
)
def test_what_are_no_directions(tmp_path, directions, phrase):
    refuse(write(tmp_path / "s.h5", directions=directions), phrase)


def test_axes_in_reverse(tmp_path):
    """As MATLAB's h5write leaves arrays (light, height, width, channel)."""
    note = "have their axes in reverse, as MATLAB writes them"
    mask, weights = MASK.T.astype(np.uint8), np.linspace(1, 2, N)[None]
    for images, found in ((IMAGES, IMAGES), (IMAGES / 255.0, (IMAGES / 255.0).astype("f4"))):
        path = write(tmp_path / "s.h5", images.transpose(), DIRECTIONS.T, mask=mask, weights=weights)
        check(path, found, note=note, mask=MASK, weights=weights[0])
    check(write(tmp_path / "s.h5", GRAY.transpose(), DIRECTIONS.T), GRAY[..., None], note=note)


@pytest.mark.parametrize(
    ("images", "directions", "phrases"),
    [
        (
            IMAGES.transpose(0, 3, 1, 2),
            DIRECTIONS,
            ["look like (light, channel, height, width)", "moveaxis(images, 1, 3)"],
        ),
        (np.moveaxis(IMAGES, 0, -1), DIRECTIONS, ["have the lights last", "moveaxis(images, -1, 0)"]),
        (np.moveaxis(GRAY, 0, -1), DIRECTIONS, ["cannot be told", "moveaxis(images, -1, 0)"]),
        (IMAGES[:, :, :N, 0], DIRECTIONS.T, ["cannot be told"]),
        (IMAGES[:-1], DIRECTIONS, ["as many images as directions"]),
        (IMAGES[None], DIRECTIONS, ["got 1×7×5×9×3"]),
    ],
)
def test_axes_that_are_in_doubt(tmp_path, images, directions, phrases):
    refuse(write(tmp_path / "s.h5", images, directions), *phrases)


def test_four_channels_are_noted(tmp_path):
    images = np.concatenate([IMAGES, IMAGES[..., :1]], 3)
    check(write(tmp_path / "s.h5", images), images, note="images have 4 channels")
    with store.open_stack(tmp_path / "s.h5") as stack:
        store.write_stack(tmp_path / "ours.h5", stack)
    with store.open_stack(tmp_path / "ours.h5") as ours:
        assert ours.notes == ()


@pytest.mark.parametrize(
    ("mask", "note"),
    [
        (MASK, None),
        (MASK.astype(np.uint8), None),
        (MASK.astype(np.uint8) * 255, None),
        (MASK.astype(">i8"), None),
        (MASK.astype(np.float64), None),
        (MASK * 255.0, None),
        (0.4 + 0.3 * MASK, "values between 0 and 1: those from 0.5 on count"),
    ],
)
def test_masks(tmp_path, mask, note):
    check(write(tmp_path / "s.h5", mask=mask), mask=MASK, note=note)


@pytest.mark.parametrize("weights", [np.arange(1, N + 1), np.arange(1.0, N + 1).astype("f4")[:, None]])
def test_weights(tmp_path, weights):
    check(write(tmp_path / "s.h5", weights=weights), weights=weights.ravel())
    refuse(write(tmp_path / "s.h5", weights=weights[:-1]), "weights must be 7")
    refuse(write(tmp_path / "s.h5", weights=np.ones((2, N))), "one number for each light")


@pytest.mark.parametrize("block", [512, 1024, 8192])
def test_a_user_block_and_a_symlink(tmp_path, block):
    path = write(tmp_path / "s.h5", file_options={"userblock_size": block})
    check(path)
    (tmp_path / "link.h5").symlink_to("s.h5")
    check(tmp_path / "link.h5")


def test_without_a_schema_the_lines_to_add_are_named(tmp_path):
    path = write(tmp_path / "s.h5", clrelight_schema=None)
    ended = call("fit", path, tmp_path / "f.h5", "--degree", 1)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    lines = ended.err.strip().partition("two lines of Python: ")[2].split("; ")
    assert len(lines) == 2
    names = {"h5py": h5py}
    for line in lines:
        exec(line, names)
    names["f"].close()
    check(path)


def test_notes_are_told(tmp_path):
    path = write(tmp_path / "s.h5", peak=None)
    note = "it has no attribute peak: 255 is taken as the value that means 1.0"
    for words in (("info", path), ("fit", path, tmp_path / "f.h5", "--degree", 1), ("psnr", tmp_path / "f.h5", path)):
        ended = call(*words)
        assert (ended.code, note in ended.out) == (0, False)
        assert ended.err.splitlines().count(f"note: {note}") == 1
        assert note in succeed(*words, "--json").json["notes"]
    bench = (
        "bench",
        path,
        "--out",
        tmp_path / "r.h5",
        "--degrees",
        1,
        "--methods",
        "uls",
        "--codecs",
        "half",
        "--force",
    )
    assert f"{path}: {note}" in succeed(*bench, "--json").json["notes"]


def test_a_foreign_stack_fits_as_our_own(tmp_path):
    own = LightStack(IMAGES, DIRECTIONS, 255.0, name="vase")
    store.write_stack(tmp_path / "own.h5", own)
    words = ("--degree", 1, "--method", "uls", "--json")
    wanted = succeed("fit", tmp_path / "own.h5", tmp_path / "f.h5", *words).json["psnr"]
    for images, directions, peak in (
        (IMAGES, DIRECTIONS, 255),
        (IMAGES.transpose(), DIRECTIONS.T, 255),
        (IMAGES.astype(">u2"), DIRECTIONS.astype("f4"), 255),
        (IMAGES.astype(int), DIRECTIONS * 1.001, 255),
    ):
        found = succeed("fit", write(tmp_path / "s.h5", images, directions, peak=peak), tmp_path / "g.h5", *words)
        for key, value in wanted.items():
            assert found.json["psnr"][key] == pytest.approx(value, abs=1e-3)


def test_old_files_of_ours_are_read_and_summed_by_hdf5(tmp_path):
    """Those written before there were checksums of blocks: with Fletcher-32."""
    path = tmp_path / "s.h5"
    store.write_stack(path, replace(LightStack(IMAGES, DIRECTIONS, 255.0), name="vase"))
    with h5py.File(path, "r+", libver="latest") as file:
        unseal(file)
        for name in ("images", "directions"):
            values = file[name][...]
            del file[name]
            file.create_dataset(name, data=values, chunks=values.shape, fletcher32=True)
    check(path)
    with h5py.File(path, "r") as file:
        at = file["images"].id.get_chunk_info(0).byte_offset
    damaged = bytearray(path.read_bytes())
    damaged[at + 9] ^= 1
    path.write_bytes(damaged)
    with store.open_stack(path) as stack, pytest.raises(StoreFormatError, match="images is damaged"):
        stack.read_rows(0, 1)


def test_a_copy_that_was_compressed_by_another_program_keeps_its_checksums(tmp_path):
    path = tmp_path / "s.h5"
    store.write_stack(path, LightStack(IMAGES, DIRECTIONS, 255.0, name="vase"))
    with h5py.File(path, "r") as source, h5py.File(tmp_path / "copy.h5", "w", userblock_size=512) as copy:
        copy.attrs.update(source.attrs)
        for name, item in source.items():
            if name != "images":
                source.copy(item, copy)
        chunks = source["images"].chunks
        copy.create_dataset("images", data=source["images"][...], chunks=chunks, compression="gzip", shuffle=True)
    check(tmp_path / "copy.h5")
    with h5py.File(tmp_path / "copy.h5", "a") as copy:
        changed = zlib.compress(np.roll(IMAGES, 1).tobytes())
        del copy["images"]
        copy.create_dataset("images", IMAGES.shape, "u1", chunks=chunks, compression="gzip")
        copy["images"].id.write_direct_chunk((0, 0, 0, 0), changed)
    with (
        store.open_stack(tmp_path / "copy.h5") as stack,
        pytest.raises(StoreFormatError, match="images is damaged: the checksum of its block 0 is wrong"),
    ):
        stack.read_rows(0, 1)
