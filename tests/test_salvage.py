"""What is left of damaged files: on the command line and from Python."""

import binascii
import shutil

import h5py
import numpy as np
import pytest

import clrelight as cr
from clrelight.codec import Encoded
from clrelight.codec.encoded import header_size
from clrelight.codec.entropy.unit_index import pack_index
from clrelight.codec.entropy.units import list_units
from clrelight.codec.formats import wavelet_draft
from clrelight.codec.formats.klt_salvage import fill_smoothly
from clrelight.codec.formats.klt_units import HEAD_SIZE, parse_body
from clrelight.codec.formats.wavelet_units import parse_body as parse_wavelet
from clrelight.dataset import FitRecord
from clrelight.errors import InputError
from clrelight.images import read_image
from clrelight.store.seal import SEAL_ATTRIBUTE
from tests.commands import call, succeed
from tests.hdf5 import unseal

HEIGHT, WIDTH = 576, 1100  # units of LL: 2 x 3
LIGHT = (0.2, 0.3, 1.0)


def make_fit(height, width, channel=1):
    """Return a smooth map with fine texture, of degree 1."""
    rng = np.random.default_rng(3)
    directions = rng.standard_normal((9, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 0.2
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    y, x = np.mgrid[:height, :width]
    maps = [1.5 + 0.4 * np.sin(x / 90 + y / 140), np.sin(y / 200), np.cos(x / 250), 0.5 * np.sin((x + y) / 150)]
    coeffs = np.stack(maps)[..., None] * np.linspace(1.0, 0.6, channel)
    coeffs = coeffs + 0.05 * rng.standard_normal((4, height, width, channel))
    record = FitRecord(1, "uls", 1.0, "linear", directions, {}, "made")
    return record.to_map(coeffs.astype(np.float32))


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A file of klt, and what it decodes to."""
    path = tmp_path_factory.mktemp("salvage") / "sound.h5"
    cr.encode(make_fit(HEIGHT, WIDTH), "klt", step=0.02, out=path)
    return path, np.array(cr.decode(path).coeffs_khwc)


def find_unit(level, row, column):
    """Return the number of the unit that holds a pixel."""
    depth = level or 5
    for number, unit in enumerate(list_units(HEIGHT, WIDTH)):
        rows, columns = ((side << depth, (side + unit.side) << depth) for side in (unit.row, unit.column))
        if unit.level == level and rows[0] <= row < rows[1] and columns[0] <= column < columns[1]:
            return number, rows, columns
    raise AssertionError


def streams_of(path):
    """Return where streams lie in the payload, and where its blocks lie in the file."""
    with h5py.File(path) as file:
        payload, blocks = file["payload"][...].tobytes(), []
        file["payload"].id.chunk_iter(lambda info: blocks.append((info.chunk_offset[0], info.byte_offset)))
    first = header_size(payload)
    parsed = parse_body(payload[first:], (4, HEIGHT, WIDTH, 1))
    return first + parsed.stored.start_t, sorted(blocks)


def damage(path, target, *numbers):
    """Copy a file, with a bit flipped in the middle of streams."""
    shutil.copy(path, target)
    start_t, blocks = streams_of(path)
    content = bytearray(target.read_bytes())
    for number in numbers:
        at = int(start_t[number] + start_t[number + 1]) // 2
        first, place = max(block for block in blocks if block[0] <= at)
        content[place + at - first] ^= 0x10
    target.write_bytes(content)
    return target


def outside(rows, columns, level):
    """Return which pixels the samples of a place do not reach."""
    margin, away = 4 << level, np.ones((HEIGHT, WIDTH), np.bool_)
    away[max(rows[0] - margin, 0) : rows[1] + margin, max(columns[0] - margin, 0) : columns[1] + margin] = False
    return away


@pytest.mark.parametrize("level", [0, 1, 2, 3, 4, 5])
def test_a_damaged_unit_costs_its_square(sound, tmp_path, level):
    path, whole_khwc = sound
    number, rows, columns = find_unit(level, 300, 600)
    broken = damage(path, tmp_path / "broken.h5", number)
    refused = call("decode", broken, tmp_path / "out.h5")
    assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
    assert not (tmp_path / "out.h5").exists()

    ended = call("decode", broken, tmp_path / "out.h5", "--salvage")
    assert ended.code == 0, ended.err
    shown = f"unit row {rows[0]}, column {columns[0]}, level {level or 'low'} damaged"
    assert ended.err.startswith(f"note: {shown}: its ")
    assert ended.err.count("\n") == 1
    found_khwc = np.array(cr.read_fit(tmp_path / "out.h5").coeffs_khwc)
    away = outside(rows, columns, level or 5)
    assert away.any() or level in (0, 5)
    np.testing.assert_array_equal(found_khwc[:, away], whole_khwc[:, away])
    assert np.isfinite(found_khwc).all()
    assert (found_khwc != whole_khwc).any()
    # What is lost is details: 0.05 of texture at fine levels, some of the waves at coarse ones.
    error = np.sqrt(np.mean((found_khwc - whole_khwc)[:, ~away] ** 2, axis=(1, 2)))
    assert error.max() < (0.35 if level in (0, 5) else 0.06), error


def test_means_of_the_finest_level_stay(sound, tmp_path):
    path, whole_khwc = sound
    number, rows, columns = find_unit(1, 300, 600)
    found_khwc = cr.decode(damage(path, tmp_path / "broken.h5", number), salvage=True, report=cr.Report()).coeffs_khwc
    square = np.s_[:, rows[0] + 8 : rows[1] - 8, columns[0] + 8 : columns[1] - 8]
    lost = (found_khwc - whole_khwc)[square].reshape(4, 56, 2, 56, 2)
    assert np.abs(lost.mean(axis=(2, 4))).mean() < 0.5 * np.abs(lost).mean()


def test_pictures_regions_levels_and_photographs(sound, tmp_path):
    path, _ = sound
    number, rows, columns = find_unit(3, 300, 600)
    broken, far = damage(path, tmp_path / "broken.h5", number), outside(rows, columns, 3)
    whole, report = cr.relight(path, LIGHT), cr.Report()
    found = cr.relight(broken, LIGHT, salvage=True, report=report)
    np.testing.assert_array_equal(found[far], whole[far])
    assert report.facts["damaged"] == [{"row": rows[0], "column": columns[0], "level": 3, "height": 512, "width": 512}]
    assert np.abs(found - whole).max() < 0.5

    # What lies elsewhere is not told of.
    for asked in ({"region": (0, 0, 200, 200)}, {"level": 3}):
        report = cr.Report()
        image = cr.relight(broken, LIGHT, salvage=True, report=report, **asked)
        np.testing.assert_array_equal(image, cr.relight(path, LIGHT, **asked))
        assert (report.facts["damaged"], report.notes) == ([], [])
    with pytest.raises(InputError, match="is damaged"):
        cr.relight(broken, LIGHT, region=(600, 300, 50, 50))

    ended = call(
        "relight", broken, tmp_path / "o.exr", "--light", "0.2,0.3,1", "--salvage", "--region", "600,300,50,50"
    )
    assert ended.err.startswith(f"note: unit row {rows[0]}, column {columns[0]}, level 3 damaged: its 512 x ")
    np.testing.assert_allclose(read_image(tmp_path / "o.exr"), found[300:350, 600:650], atol=1e-5)

    assert call("unpack", broken, tmp_path / "photos", "--format", "exr").code == 2
    assert not (tmp_path / "photos").exists()
    ended = call("unpack", broken, tmp_path / "photos", "--format", "exr", "--salvage", "--json")
    assert ended.code == 0
    assert [each["level"] for each in ended.json["damaged"]] == [3]
    succeed("unpack", path, tmp_path / "before", "--format", "exr")
    for name in ("light_000.exr", "light_008.exr"):
        one, other = read_image(tmp_path / "photos" / name), read_image(tmp_path / "before" / name)
        np.testing.assert_array_equal(one[far], other[far])


def test_light_from_everywhere_on_a_damaged_file(sound, tmp_path):
    path, _ = sound
    number, rows, columns = find_unit(2, 300, 600)
    broken, sky = damage(path, tmp_path / "broken.h5", number), cr.sky_light("clear", 35, 120, degree=2)
    report = cr.Report()
    found = cr.relight(broken, sky, salvage=True, report=report)
    far = outside(rows, columns, 2)
    np.testing.assert_array_equal(found[far], cr.relight(path, sky, report=cr.Report())[far])
    assert report.facts["damaged"][0]["level"] == 2


@pytest.mark.parametrize("level", [0, 4])
def test_what_is_filled_does_not_hang_on_the_region(sound, tmp_path, level):
    broken = damage(sound[0], tmp_path / "broken.h5", find_unit(level, 300, 600)[0])
    whole_khwc = cr.decode(broken, salvage=True, report=cr.Report()).coeffs_khwc
    relit = cr.relight(cr.read_encoded(sound[0])[1].to_map(whole_khwc), LIGHT)
    for x, y, w, h in ((480, 200, 70, 40), (700, 530, 400, 46)):
        asked = {"region": (x, y, w, h), "salvage": True, "report": cr.Report()}
        np.testing.assert_allclose(
            cr.decode(broken, **asked).coeffs_khwc, whole_khwc[:, y : y + h, x : x + w], atol=5e-6
        )
        np.testing.assert_allclose(cr.relight(broken, LIGHT, **asked), relit[y : y + h, x : x + w], atol=5e-6)
        assert [each["level"] for each in asked["report"].facts["damaged"]] == [level or "low"]


def test_all_that_can_be_salvaged_of_everything(sound, tmp_path):
    """Every unit damaged: the mean is left."""
    path, whole_khwc = sound
    count = len(list_units(HEIGHT, WIDTH))
    report = cr.Report()
    found_khwc = cr.decode(damage(path, tmp_path / "b.h5", *range(count)), salvage=True, report=report).coeffs_khwc
    assert np.ptp(found_khwc, axis=(1, 2)).max() < 1e-5
    assert np.abs(found_khwc[:, 0, 0] - whole_khwc.mean(axis=(1, 2))).max() < 0.1
    # Those that hang on damaged ones are lost with them, and not named; of many, the first are.
    low = [unit for unit in list_units(HEIGHT, WIDTH) if unit.level in (0, 5)]
    assert len(report.facts["damaged"]) == len(low)
    assert len(report.notes) == len(low)


def test_a_sound_file_is_the_same_and_nothing_is_said(sound, tmp_path):
    path, whole_khwc = sound
    report = cr.Report()
    np.testing.assert_array_equal(cr.decode(path, salvage=True, report=report).coeffs_khwc, whole_khwc)
    assert (report.notes, report.facts["damaged"]) == ([], [])
    assert succeed("decode", path, tmp_path / "o.h5", "--salvage").code == 0
    np.testing.assert_array_equal(cr.read_fit(tmp_path / "o.h5").coeffs_khwc, whole_khwc)


def test_a_stream_that_is_none_although_its_checksum_fits(sound):
    path, whole_khwc = sound
    encoded = cr.read_encoded(path)[0]
    parsed = parse_body(encoded.body, encoded.shape)
    streams = [encoded.body[a:b] for a, b in zip(parsed.stored.start_t[:-1], parsed.stored.start_t[1:], strict=True)]
    for level in (0, 4):
        number, rows, columns = find_unit(level, 300, 600)
        forged = list(streams)
        forged[number] = bytes(b ^ 0x5A for b in streams[number])
        front = encoded.body[: HEAD_SIZE + parsed.head.axes_bytes] + pack_index(forged)
        body = front + binascii.crc_hqx(front, 0).to_bytes(2, "little") + b"".join(forged)
        bad = Encoded(encoded.codec, {}, encoded.shape, body, record=encoded.record)
        with pytest.raises(InputError, match="cannot be decoded"):
            cr.decode(bad)
        report = cr.Report()
        found_khwc = cr.decode(bad, salvage=True, report=report).coeffs_khwc
        assert len(report.notes) == 1
        assert f"level {level or 'low'} damaged" in report.notes[0]
        away = outside(rows, columns, level or 5)
        np.testing.assert_array_equal(found_khwc[:, away], whole_khwc[:, away])


@pytest.fixture(scope="module")
def grouped():
    """Return an encoding by wavelet whose planes are in two groups, and what it decodes to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wavelet_draft, "_STREAM_BYTES", 1 << 8)
        patch.setattr(wavelet_draft, "_GROUP", 2)
        encoded = cr.encode(make_fit(HEIGHT, WIDTH), "wavelet", rate=0.5)
    return encoded, cr.decode(encoded).coeffs_khwc


@pytest.mark.parametrize("level", [0, 2])
def test_a_unit_of_wavelet_is_lost_where_a_group_of_its_planes_is(grouped, level):
    encoded, whole_khwc = grouped
    stored = parse_wavelet(encoded.body, encoded.shape)[1]
    assert stored.groups == [(0, 2), (2, 4)]
    number, rows, columns = find_unit(level, 300, 600)
    stream = stored.numbers(list_units(HEIGHT, WIDTH), [number])[1]
    body = bytearray(encoded.body)
    body[int(stored.start_t[stream] + stored.start_t[stream + 1]) // 2] ^= 0x10
    broken = Encoded(encoded.codec, {}, encoded.shape, bytes(body), record=encoded.record)
    with pytest.raises(InputError, match=f"unit {stream} of the wavelet body is damaged"):
        cr.decode(broken)
    report = cr.Report()
    found_khwc = cr.decode(broken, salvage=True, report=report).coeffs_khwc
    assert f"unit row {rows[0]}, column {columns[0]}, level {level or 'low'} damaged" in report.notes[0]
    away = outside(rows, columns, level or 5)
    np.testing.assert_array_equal(found_khwc[:, away], whole_khwc[:, away])
    error = np.sqrt(np.mean((found_khwc - whole_khwc)[:, ~away] ** 2, axis=(1, 2)))
    assert (error > 0).all()
    assert error.max() < (0.06 if level else 0.35), error
    relit = cr.relight(broken, LIGHT, salvage=True, report=cr.Report())
    np.testing.assert_allclose(relit, cr.relight(encoded.record.to_map(found_khwc), LIGHT), atol=5e-6)


def test_attributes_and_checksums_that_were_changed(sound, tmp_path):
    path, whole_khwc = sound
    changed = tmp_path / "changed.h5"
    shutil.copy(path, changed)
    with h5py.File(changed, "r+") as file:
        seal = file["payload"].attrs[SEAL_ATTRIBUTE]
        file["payload"].attrs.modify(SEAL_ATTRIBUTE, np.bytes_(bytes([seal[0] ^ 1]) + bytes(seal[1:])))
        file["payload"][header_size(file["payload"][:300].tobytes()) - 1] ^= 1  # the checksum of the payload
    refused = call("decode", changed, tmp_path / "o.h5")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    ended = call("decode", changed, tmp_path / "o.h5", "--salvage")
    assert ended.code == 0, ended.err
    assert "are not as they were written: it is read without them" in ended.err
    np.testing.assert_array_equal(cr.read_fit(tmp_path / "o.h5").coeffs_khwc, whole_khwc)


def test_a_copy_with_checksums_of_hdf5(sound, tmp_path):
    """Of a block of another program, whose checksum HDF5 finds wrong, all units but one are got at."""
    path, whole_khwc = sound
    number, rows, columns = find_unit(1, 300, 600)
    start_t, _ = streams_of(path)
    copied = tmp_path / "copied.h5"
    shutil.copy(path, copied)
    with h5py.File(copied, "r+") as file:
        unseal(file)
        content, attributes = file["payload"][...], dict(file["payload"].attrs)
        del file["payload"]
        made = file.create_dataset("payload", data=content, chunks=(50_000,), fletcher32=True)
        made.attrs.update(attributes)
        blocks = []
        made.id.chunk_iter(lambda info: blocks.append((info.chunk_offset[0], info.byte_offset)))
    at = int(start_t[number]) + 20
    first, place = max(block for block in blocks if block[0] <= at)
    stored = bytearray(copied.read_bytes())
    stored[place + at - first] ^= 4
    copied.write_bytes(stored)
    assert call("decode", copied, tmp_path / "o.h5").code == 2
    report = cr.Report()
    found_khwc = cr.decode(copied, salvage=True, report=report).coeffs_khwc
    assert [each["level"] for each in report.facts["damaged"]] == [1]
    away = outside(rows, columns, 1)
    np.testing.assert_array_equal(found_khwc[:, away], whole_khwc[:, away])


def test_what_cannot_be_salvaged(sound, tmp_path):
    path, _ = sound
    start_t, blocks = streams_of(path)
    tables = tmp_path / "tables.h5"
    content = bytearray(path.read_bytes())
    content[blocks[0][1] + int(start_t[0]) - 5] ^= 1
    tables.write_bytes(content)
    cr.encode(make_fit(40, 50), "half", out=tmp_path / "half.h5")
    cr.write_fit(tmp_path / "fit.h5", make_fit(40, 50))
    small = tmp_path / "small.h5"
    cr.encode(make_fit(400, 500), "klt", step=0.02, out=small)
    with h5py.File(small, "r+") as file:
        file["payload"][-100] ^= 1
    for words, told in (
        (("decode", tables, tmp_path / "o.h5"), "tables or its index of units are damaged"),
        (("decode", tmp_path / "half.h5", tmp_path / "o.h5"), "an encoding by half holds no units that stand alone"),
        (("relight", tmp_path / "fit.h5", tmp_path / "o.exr", "--light", "0,0,1"), "a fit holds no units that stand"),
        (("relight", tmp_path / "half.h5", tmp_path / "o.exr", "--light", "0,0,1"), "an encoding by half holds no"),
        (("unpack", tmp_path / "half.h5", tmp_path / "o"), "an encoding by half holds no units that stand alone"),
        (("decode", small, tmp_path / "o.h5"), "all of its units are one stream: none can be salvaged"),
        (("decode", tmp_path / "fit.h5", tmp_path / "o.h5"), "it is a fit/1 file, expected encoded/4"),
    ):
        ended = call(*words, "--salvage")
        assert (ended.code, ended.out, ended.err.count("clrelight:")) == (2, "", 1), ended.err
        assert told in ended.err
        assert not (tmp_path / "o.h5").exists()


def test_filling_is_smooth():
    y, x = np.mgrid[:20, :30]
    planes = np.stack([100 * x - 70 * y, 5 * (x**2 - y**2), 0 * x + 9]).astype(np.int32)
    is_known = np.ones((20, 30), np.bool_)
    is_known[4:12, 7:19] = False
    np.testing.assert_array_equal(fill_smoothly(np.where(is_known, planes, 77), is_known), planes)
    is_known[:] = False
    is_known[0, 0] = True
    assert (fill_smoothly(planes, is_known) == planes[:, :1, :1]).all()
    is_known[:] = False
    assert not fill_smoothly(planes, is_known).any()
    assert fill_smoothly(planes, ~is_known).tobytes() == planes.tobytes()
