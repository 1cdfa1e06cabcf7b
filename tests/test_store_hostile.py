"""Files that others made, damaged, or made to do harm: each is refused in one line, or reads as it should."""

import json
import math
import os
import struct
import subprocess
import sys
import textwrap
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_store import directions, make_encoded, make_fit, make_results, make_stack, write_each

from clrelight import store
from clrelight.errors import InputError, StoreFormatError
from clrelight.results import Results
from clrelight.store.usual import USUAL
from clrelight.store.walk import MAX_DEPTH
from tests.hdf5 import content, unseal

MAGIC = b"\x89HDF\r\n\x1a\n"


def refused(path, *phrases, kind="stack"):
    """Check that every way to open a file refuses it, in one line that names it."""
    for reader in (lambda: content(kind, path), lambda: store.describe(path)):
        with pytest.raises(StoreFormatError) as caught:
            reader()
        text = str(caught.value)
        assert "\n" not in text
        assert str(path) in text
        assert any(phrase in text for phrase in phrases), text


def refusal(kind, path, expected):
    """Return whether a damaged file is refused; if it is not, it must read as the sound one did."""
    try:
        assert content(kind, path) == expected
    except InputError as error:
        return (str(path) in str(error) and "\n" not in str(error)) or pytest.fail(str(error))
    return False


@pytest.fixture
def stack_file(tmp_path):
    path = tmp_path / "stack.h5"
    store.write_stack(path, make_stack())
    return path


def edit(path, change):
    """Change a file as another program would, and take away the seal of ours, as it is told to."""
    with h5py.File(path, "r+", libver="latest") as file:
        unseal(file)
        change(file)


@pytest.mark.parametrize("kind", ["stack", "fit", "encoded", "results"])
def test_flipped_bits(tmp_path, kind):
    path = write_each(tmp_path)[kind]
    good, expected = path.read_bytes(), content(kind, path)
    rng = np.random.default_rng(7)
    refusals = 0
    for _ in range(300):
        bad = bytearray(good)
        bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
        path.write_bytes(bad)
        refusals += refusal(kind, path, expected)
    assert refusals > 100


@pytest.mark.parametrize("kind", ["stack", "fit", "encoded", "results"])
def test_overwritten_and_cut(tmp_path, kind):
    path = write_each(tmp_path)[kind]
    good, expected = path.read_bytes(), content(kind, path)
    rng = np.random.default_rng(8)
    for _ in range(100):
        bad = bytearray(good)
        at, n = rng.integers(len(bad)), rng.integers(1, 64)
        bad[at : at + n] = rng.integers(0, 256, len(bad[at : at + n]), np.uint8).tobytes()
        path.write_bytes(bad)
        refusal(kind, path, expected)
    for n in rng.integers(0, len(good), 100):
        path.write_bytes(good[:n])
        refused(path, "cut short", "empty", "not an HDF5", "damaged", kind=kind)


def test_what_is_no_file_of_ours(tmp_path):
    with pytest.raises(InputError, match=r"there is no file .*none\.h5"), store.open_stack(tmp_path / "none.h5"):
        pass
    with pytest.raises(InputError, match="no file name"):
        store.read_fit("a\0b")
    (tmp_path / "empty.h5").touch()
    refused(tmp_path / "empty.h5", "is empty")
    (tmp_path / "text.h5").write_text("# a text\n")
    refused(tmp_path / "text.h5", "is not an HDF5 file")
    (tmp_path / "magic.h5").write_bytes(MAGIC + bytes(100))
    refused(tmp_path / "magic.h5", "damaged", "cut short")
    (tmp_path / "folder.h5").mkdir()
    refused(tmp_path / "folder.h5", "no regular file")
    os.mkfifo(tmp_path / "fifo.h5")
    refused(tmp_path / "fifo.h5", "no regular file")
    store.write_stack(tmp_path / "s.h5", make_stack())
    (tmp_path / "link.h5").symlink_to("folder.h5")
    refused(tmp_path / "link.h5", "no regular file")
    (tmp_path / "loop.h5").symlink_to("loop.h5")
    with pytest.raises(InputError, match=r"cannot read .*loop\.h5"):
        store.describe(tmp_path / "loop.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["images"] = np.zeros(3)
    refused(tmp_path / "other.h5", "f.attrs['clrelight_schema'] = 'stack/1'")


def test_other_schemas_are_named(tmp_path):
    paths = write_each(tmp_path)
    for kind, path in paths.items():
        for other in paths:
            if other != kind:
                with pytest.raises(StoreFormatError, match=rf"is an? {kind}/[14] file, expected {other}/[14]"):
                    content(other, path)

    def rename(text):
        edit(paths["fit"], lambda f: f.attrs.create("clrelight_schema", np.bytes_(text)))

    rename("fit/3")
    refused(paths["fit"], "fit/3 is newer than this program reads (fit/2): upgrade clrelight", kind="fit")
    for text in ("fits/1", "fit/0", "fit", "fit/1x", "fit/-1"):
        rename(text)
        refused(paths["fit"], f"unknown schema '{text}'", kind="fit")


def set_attribute(name, value):
    return lambda f: f.attrs.__setitem__(name, value)


def replace_data(name, data, **options):
    def change(file):
        del file[name]
        file.create_dataset(name, data=data, **options)

    return change


def delete(name):
    return lambda f: f.__delitem__(name)


def remove_attribute(name):
    return lambda f: f.attrs.__delitem__(name)


GOOD = make_stack()


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (set_attribute("peak", math.nan), "peak must be a positive number"),
        (set_attribute("peak", math.inf), "peak must be a positive number"),
        (set_attribute("peak", [1.0, 2.0]), "peak must be one float"),
        (set_attribute("peak", np.bytes_("1")), "peak must be one float"),
        (set_attribute("peak", h5py.Empty("f8")), "peak must be one float"),
        (set_attribute("transfer", np.bytes_("gamma")), "transfer must be one of"),
        (set_attribute("transfer", 1), "transfer must be one text"),
        (set_attribute("transfer", ["srgb", "linear"]), "transfer must be one text"),
        (set_attribute("transfer", np.bytes_(b"\xff\xfe")), "damaged"),
        (set_attribute("clrelight_schema", 1), "clrelight_schema must be one text"),
        (remove_attribute("clrelight_schema"), "no clrelight file"),
        (delete("images"), "no dataset images"),
        (delete("directions"), "no dataset directions"),
        (replace_data("directions", GOOD.directions_i3 * 2), "no finite unit vector"),
        (replace_data("directions", GOOD.directions_i3 * np.nan), "no finite unit vector"),
        (replace_data("directions", GOOD.directions_i3 * 1.02), "no finite unit vector"),
        (replace_data("directions", GOOD.directions_i3[:4]), "as many images as directions"),
        (replace_data("directions", GOOD.directions_i3[:, :2]), "directions are float64 (5, 2), expected numbers N×3"),
        (replace_data("directions", np.array([[b"x"] * 3] * 5)), "something else than integers and floats"),
        (replace_data("weights", -GOOD.weights_i), "weights must be"),
        (replace_data("mask", np.full((7, 6), 2, "u1")), "mask must be 0 and 1"),
        (replace_data("mask", np.full((7, 6), np.nan)), "mask must be 0 and 1"),
        (replace_data("mask", np.full((7, 6), -0.5)), "mask must be 0 and 1"),
        (replace_data("mask", np.arange(42, dtype="u1").reshape(7, 6) * 6), "mask must be 0 and 1"),
        (replace_data("mask", np.zeros((6, 7), "u1")), "mask is 6×7, the images are 7×6"),
        (replace_data("mask", np.zeros((7, 5), "u1")), "mask is uint8 (7, 5), expected 7×6"),
        (replace_data("images", np.zeros((5, 7), "u1")), "got 5×7"),
        (replace_data("images", np.zeros((5, 7, 6, 0), "u1")), "none of them empty"),
        (replace_data("images", np.zeros((5, 7, 6, 3), "c16")), "numbers that fit one of them, got complex128"),
        (replace_data("images", h5py.Empty("u1")), "has no shape"),
        (replace_data("images", 1), "images must be (light, height, width, channel)"),
        (replace_data("images", "text"), "something else than integers and floats"),
        (replace_data("images", 1, dtype=h5py.enum_dtype({"A": 1})), "something else"),
    ],
)
def test_wrong_values(stack_file, change, phrase):
    edit(stack_file, change)
    refused(stack_file, phrase)


def test_wrong_values_of_a_fit(tmp_path):
    path = tmp_path / "f.h5"
    deep = "[" * 20000
    for name, value, phrase in (
        ("degree", 3, "degree 3 has 16 coefficients"),
        ("degree", -4, "degree -4"),
        ("degree", 2.0, "degree must be one int"),
        ("degree", 2**63 - 1, "coefficients, got 9"),
        ("config", np.bytes_("{"), "not valid JSON"),
        ("config", np.bytes_("[1]"), "must be a JSON object"),
        ("config", np.bytes_('{"a": NaN}'), "not valid JSON"),
        ("config", np.bytes_(deep), "not valid JSON"),
        ("config", np.bytes_('{"a": ' + "9" * 5000 + "}"), "not valid JSON"),
    ):
        store.write_fit(path, make_fit())
        edit(path, set_attribute(name, value))
        refused(path, phrase, kind="fit")
    for name, data in (("lambda", np.zeros((5, 4, 2), "f4")), ("rank", np.zeros((5, 4, 3), "f4"))):
        store.write_fit(path, make_fit())
        edit(path, replace_data(name, data))
        refused(path, name, kind="fit")


BEFORE = Path(__file__).parent / "frozen" / "encoded.1.hdf"


def packed(text):
    packer = zlib.compressobj(9, zlib.DEFLATED, -15, 9, zlib.Z_DEFAULT_STRATEGY, USUAL)
    return np.frombuffer(packer.compress(text) + packer.flush(), "u1")


def change_record(behind=b"", **facts):
    """Change facts in the record of an encoding, and put bytes behind its directions."""

    def change(file):
        unpacker = zlib.decompressobj(-15, USUAL)
        held = json.loads(unpacker.decompress(file.attrs["record"].tobytes()))
        text = packed(json.dumps({**held, **facts}).encode()).tobytes()
        file.attrs["record"] = np.frombuffer(text + unpacker.unused_data + behind, "u1")

    return change


def test_wrong_values_of_encoded_and_results(tmp_path):
    path = tmp_path / "e.h5"
    for change, phrase in (
        (set_attribute("codec", np.bytes_("s3tc")), "codec is 's3tc'"),
        (set_attribute("encoded_bytes", 1), "encoded_bytes is 1"),
        (set_attribute("bits_per_coefficient", math.nan), "bits_per_coefficient is nan"),
        (set_attribute("degree", 3), "degree 3"),
        (set_attribute("fit_config", np.bytes_("x")), "fit_config is not valid JSON"),
        (replace_data("payload", np.zeros(10, "u1")), "payload should have"),
        (replace_data("header", np.zeros(10, "u1")), "not a clrelight payload"),
        (replace_data("header", np.zeros((2, 5), "u1")), "with 1 axes"),
    ):
        path.write_bytes(BEFORE.read_bytes())
        edit(path, change)
        refused(path, phrase, kind="encoded")
    for change, phrase in (
        (replace_data("payload", np.zeros(10, "u1")), "not a clrelight payload"),
        (replace_data("payload", np.zeros((2, 5), "u1")), "with 1 axes"),
        (set_attribute("record", np.zeros(0, "u1")), "record must be bytes"),
        (set_attribute("record", np.bytes_("x")), "record must be bytes"),
        (set_attribute("record", np.zeros(40, "u1")), "damaged or not ours"),
        (set_attribute("record", packed(b"[1]")), "must be a JSON object"),
        (set_attribute("record", packed(b"{}")), "record must have method"),
        (change_record(degree=3), "degree 3"),
        (change_record(degree=True), "record must have degree"),
        (change_record(degree=2.0), "record must have degree"),
        (change_record(peak="1"), "record must have peak"),
        (change_record(info={"step": "x"}), "could not convert"),
        (change_record(behind=b"1234"), "do not end where"),
        (set_attribute("record", packed(b" " * (2 << 20))), "inflates to more than"),
    ):
        store.write_encoded(path, make_encoded(make_fit()), make_fit())
        edit(path, change)
        refused(path, phrase, kind="encoded")
    path = tmp_path / "r.h5"
    for change, phrase in (
        (replace_data("table", np.zeros(3, [("scene", "S64")])), "expected the row type"),
        (replace_data("table", np.zeros(3)), "expected the row type"),
        (lambda f: f["pictures/p00001"].attrs.__setitem__("key", np.bytes_("ring/reference")), "of another one"),
        (lambda f: f["pictures/p00001"].attrs.__delitem__("key"), "no attribute key"),
        (lambda f: f.create_dataset("pictures/p3", data=np.zeros((2, 2, 3), "f4")), "pictures/p3 is <f4"),
        (lambda f: f.create_dataset("pictures/a/p3", data=np.zeros((2, 2, 3), "u1")), "does not know"),
        (lambda f: f.create_dataset("pictures/ein bild", data=np.zeros((2, 2, 3), "u1")), "none of ours"),
        (lambda f: f["pictures"].__setitem__("p3", np.dtype("f8")), "neither a group nor a dataset"),
    ):
        store.write_results(path, make_results())
        edit(path, change)
        refused(path, phrase, kind="results")


# Made to lead out of the file


def test_links(stack_file, tmp_path):
    store.write_stack(tmp_path / "other.h5", make_stack())
    store.write_stack(stack_file, make_stack(optional=False))
    good = stack_file.read_bytes()

    def swap(link):
        def change(file):
            del file["images"]
            file["images"] = link

        return change

    def cycle(file):
        file.create_group("mask")["b"] = file["/"]

    def group_cycle(file):
        mask = file.create_group("mask")
        mask.create_group("b")["c"] = mask

    for change, phrase in (
        (swap(h5py.ExternalLink(str(tmp_path / "other.h5"), "/images")), "soft or external link"),
        (swap(h5py.SoftLink("/mask")), "soft or external link"),
        (lambda f: f.__setitem__("dangling", h5py.SoftLink("/nothing")), "soft or external link"),
        (lambda f: f.__setitem__("g", h5py.ExternalLink("other.h5", "/")), "soft or external link"),
        (lambda f: f.__setitem__("weights", f["images"]), "linked twice"),
        (cycle, "linked twice"),
        (group_cycle, "linked twice"),
        (lambda f: f.create_group("/".join(["mask", *"abcdefghij"[:MAX_DEPTH]])), "deeper than"),
    ):
        stack_file.write_bytes(good)
        edit(stack_file, change)
        refused(stack_file, phrase)


def test_values_elsewhere(stack_file, tmp_path):
    good = stack_file.read_bytes()
    secret = tmp_path / "secret"
    secret.write_bytes(b"secret" * 1000)
    layout = h5py.VirtualLayout((5, 7, 6, 3), "u1")
    store.write_stack(tmp_path / "other.h5", make_stack())
    layout[...] = h5py.VirtualSource(str(tmp_path / "other.h5"), "images", (5, 7, 6, 3))

    def virtual(file):
        del file["images"]
        file.create_virtual_dataset("images", layout)

    def external(file):
        del file["images"]
        file.create_dataset("images", (5, 7, 6, 3), "u1", external=[(str(secret), 0, 630)])

    for change, phrase in ((virtual, "virtual dataset"), (external, "keeps its values in another file")):
        stack_file.write_bytes(good)
        edit(stack_file, change)
        refused(stack_file, phrase)


# Made to fill memory, or to make HDF5 read where it should not


def claim(shape, written=None, dtype="u1", **options):
    def change(file):
        for name in ("images", "directions", "weights", "mask"):
            del file[name]
        dataset = file.create_dataset("images", shape, dtype, **options)
        if written is not None:
            dataset.id.write_direct_chunk((0,) * len(shape), *written)

    return change


def fletcher32(data):
    low = high = 0
    for (word,) in struct.iter_unpack(">H", data):
        low = (low + word) % 65535
        high = (high + low) % 65535
    return struct.pack("<I", high << 16 | low)


SIXTEEN = bytes(16)
ONE = (1, 1 << 12, 1 << 8, 1)


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (claim((1 << 10, 1 << 15, 1 << 15, 4)), "are stored"),
        (claim((1 << 10, 1 << 15, 1 << 15, 4), chunks=(1, 64, 64, 1)), "are stored"),
        (claim((1, 1 << 14, 1 << 15, 1), chunks=(1, 1 << 14, 1 << 15, 1), compression="gzip"), "are stored"),
        (claim((1, 1 << 12, 1 << 9, 1), chunks=ONE, compression="gzip"), "should have 2 chunks"),
        (claim(ONE, chunks=ONE, compression="lzf"), "filter 32000"),
        (claim(ONE, chunks=ONE, dtype="i4", scaleoffset=0), "filter 6"),
        (claim(ONE, (SIXTEEN,), chunks=ONE), "are stored"),
        (claim(ONE, (SIXTEEN + fletcher32(SIXTEEN),), chunks=ONE, fletcher32=True), "are stored"),
        (claim(ONE, (SIXTEEN, 1), chunks=ONE, compression="gzip"), "0 are so"),
        (claim(ONE, (zlib.compress(SIXTEEN),), chunks=ONE, compression="gzip"), "does not inflate to"),
        (claim(ONE, (zlib.compress(bytes(100 << 20)),), chunks=ONE, compression="gzip"), "does not inflate to"),
        (claim(ONE, (bytes(4 << 20),), chunks=ONE, compression="gzip"), "more bytes than it would"),
        (claim(ONE, (bytes(100),), chunks=ONE, compression="gzip"), "damaged"),
    ],
)
def test_sizes(stack_file, change, phrase):
    edit(stack_file, change)
    edit(stack_file, lambda f: f.__setitem__("directions", directions(f["images"].shape[0])))
    with pytest.raises(StoreFormatError, match=phrase), store.open_stack(stack_file) as stack:
        stack.images_ihwc[0, :5]


def test_a_short_chunk_behind_a_long_one(stack_file):
    # Together they have bytes enough; HDF5 would read on behind the short one.
    def change(file):
        shape, half = (5, 7, 6, 3), (5, 7, 3, 3)
        del file["images"]
        images = file.create_dataset("images", shape, "u1", chunks=half, fletcher32=True)
        for column, n in ((0, 16), (3, 1000)):
            images.id.write_direct_chunk((0, 0, column, 0), bytes(n) + fletcher32(bytes(n)))

    edit(stack_file, change)
    refused(stack_file, "should have 2 chunks of 319 bytes, 0 are so")


def test_compressed_files_of_others_are_read(stack_file):
    stack = make_stack("uint16")
    edit(stack_file, replace_data("images", stack.images_ihwc, chunks=(2, 3, 6, 3), compression="gzip", shuffle=True))
    keys = (..., 0, -1, (slice(None), 2), (slice(1, 4), slice(3, 5)), (..., 1), ([0, 3], slice(2, 4)), (1, ..., 2))
    for key in keys:
        with store.open_stack(stack_file) as back:
            np.testing.assert_array_equal(back.images_ihwc[key], stack.images_ihwc[key])
    edit(stack_file, replace_data("images", stack.images_ihwc, compression="gzip", fletcher32=True))
    with store.open_stack(stack_file) as back:
        np.testing.assert_array_equal(back.images_ihwc, stack.images_ihwc)
    with h5py.File(stack_file, "r+") as file:
        file["images"].id.write_direct_chunk((0, 0, 0, 0), zlib.compress(bytes(64 << 20)) + bytes(4))
    with store.open_stack(stack_file) as back, pytest.raises(StoreFormatError, match="images is damaged"):
        back.images_ihwc[..., 0]


def test_damage_is_said_when_the_tile_is_read(tmp_path):
    path = tmp_path / "s.h5"
    stack = make_stack("float32", (4, 400, 64, 3))
    store.write_stack(path, stack)
    with h5py.File(path) as file:
        chunk = file["images"].id.get_chunk_info(1)
    with open(path, "r+b") as raw:
        raw.seek(chunk.byte_offset + 5)
        raw.write(b"\xff")
    with store.open_stack(path) as back:
        rows = back.images_ihwc.chunks[1]
        np.testing.assert_array_equal(back.images_ihwc[:, :rows], stack.images_ihwc[:, :rows])
        with pytest.raises(StoreFormatError, match=r"s\.h5: images is damaged"):
            back.images_ihwc[:, rows : 2 * rows]


def test_many_objects(tmp_path):
    path = tmp_path / "r.h5"
    store.write_results(path, Results(make_results().table))
    edit(path, lambda f: [f.create_group(f"pictures/g{i}") for i in range(200)])
    script = f"""
        from clrelight import store
        from clrelight.store import walk
        walk.MAX_OBJECTS = 100
        store.read_results({str(path)!r})
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, timeout=60)
    assert "more than 100 objects" in done.stderr


def test_plugins_are_not_looked_for(stack_file):
    h5py.h5pl.append(b"/nowhere")
    store.file_schema(stack_file)
    assert h5py.h5pl.size() == 0


def test_an_error_of_the_caller_stays_his(stack_file):
    for error in (OSError("mine"), RuntimeError("mine"), KeyError("mine")):
        with pytest.raises(type(error), match="mine"), store.open_stack(stack_file):
            raise error
