"""The page's decoder of klt 4, a second implementation of docs/bitstream.md, against Python's."""

import base64
from pathlib import Path

import numpy as np
import pytest

from clrelight.codec import codec_class, decode_regions, encode
from clrelight.codec.encoded import Encoded
from clrelight.codec.entropy.units import list_units
from clrelight.codec.formats.klt_units import parse_body
from clrelight.codec.minimum_size import drop_padding
from clrelight.codec.views import Region
from clrelight.device import open_device
from clrelight.errors import PayloadError
from tests import mutations
from tests.javascript import evaluate
from tests.reference.entropy import list_bands
from tests.reference.klt4 import START, decode_klt4
from tests.reference.payload import open_payload

FROZEN = sorted((Path(__file__).parent / "frozen").glob("klt.4*.bin"))
OPEN = """
const { Units, lengthWithoutPadding, decodeRegion, joinPlane, planRegion, fromBase64, halved } = clrelight;
const toBase64 = (array) => {
  let text = "";
  const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
  for (const byte of bytes) text += String.fromCharCode(byte);
  return btoa(text);
};
const open = ({ body, shape }) => {
  const bytes = fromBase64(body);
  const length = lengthWithoutPadding(bytes.length, bytes.subarray(-4), shape);
  const read = async (begin, end) => bytes.subarray(begin, end);
  return new Units(shape, bytes.subarray(0, length), length, read, fromBase64(data.start));
};
const wholePlanes = async (units) => {
  await units.need([...Array(units.count).keys()]);
  const plan = planRegion(units, 0, [0, units.height], [0, units.width]);
  const planes = new Float32Array(units.planes * units.height * units.width);
  for (let p = 0; p < units.planes; p++) planes.set(joinPlane(units, plan, p).values, p * units.height * units.width);
  return planes;
};
"""


def told(payload):
    opened = open_payload(payload)
    return {"body": base64.b64encode(opened.body).decode(), "shape": opened.shape}


def run(code, **data):
    return evaluate(OPEN + code, {"start": base64.b64encode(START.read_bytes()).decode(), **data})


def numbers(text, dtype="<f4"):
    return np.frombuffer(base64.b64decode(text), dtype)


def planes_of_ours(payload, device, region=None):
    """Return planes in steps of a payload, by the program."""
    encoded = Encoded.from_bytes(payload)
    view = decode_regions(encoded)
    return view._planes._reader(device).planes(region or Region(0, 0, *encoded.shape[1:3]))


@pytest.fixture(scope="module")
def device():
    return open_device()


@pytest.fixture(scope="module")
def cases(device):
    return [path.read_bytes() for path in FROZEN] + [mutations.make_units(number, device) for number in range(13)]


def test_indices_are_those_of_the_reference(device):
    payloads = [path.read_bytes() for path in FROZEN] + [mutations.make_units(number, device) for number in (2, 5, 9)]
    code = """
    return Promise.all(data.payloads.map(async (each) => {
      const units = open(each);
      await units.need([...Array(units.count).keys()]);
      return [...Array(units.count).keys()].map((number) => ({
        ...units.place(number), values: (units.kept.get(number)?.bands ?? []).map((band) => band && [...band.values]),
      }));
    }));
    """
    for payload, units in zip(payloads, run(code, payloads=[told(each) for each in payloads]), strict=True):
        opened = open_payload(payload)
        expected = decode_klt4(opened.body, opened.shape).indices
        bands = {(band.name, band.level): band for band in list_bands(*opened.shape[1:3], 5)}
        found = np.full(expected.shape, 1 << 30)
        for unit in units:
            names = ("HL", "LH", "HH") if unit["level"] else ("LL",)
            for name, place, values in zip(names, unit["bands"], unit["values"], strict=bool(len(expected))):
                if place is not None:
                    rows = slice(unit["row"], unit["row"] + place["rows"])
                    columns = slice(unit["column"], unit["column"] + place["columns"])
                    part = bands[name, unit["level"] or 5].view(found)[:, rows, columns]
                    part[...] = np.reshape(values, part.shape)
        np.testing.assert_array_equal(found, expected)


def test_planes_are_those_of_the_program(cases, device):
    code = "return Promise.all(data.payloads.map(async (each) => toBase64(await wholePlanes(open(each)))));"
    for payload, text in zip(cases, run(code, payloads=[told(each) for each in cases]), strict=True):
        expected = planes_of_ours(payload, device)
        np.testing.assert_allclose(numbers(text), expected.ravel(), rtol=0, atol=2e-6 * np.abs(expected).max(initial=0))


REGIONS = [
    (0, 0, 0, 520, 513),
    (0, 250, 251, 263, 262),
    (1, 100, 120, 260, 257),
    (3, 0, 0, 65, 65),
    (4, 3, 5, 30, 20),
    (5, 0, 0, 17, 17),
]


def test_regions_at_levels_of_many_units(device):
    payload = mutations.make_units(15, device)  # 520 x 513: a stream for each unit
    assert Encoded.from_bytes(payload).shape[1:3] == (520, 513)
    code = """
    const found = [];
    for (const [level, top, left, bottom, right] of data.regions) {
      const units = open(data.payload);
      let asked = 0;
      const read = units.read;
      units.read = (begin, end) => ((asked += end - begin), read(begin, end));
      const scales = Array(units.planes).fill(1);
      const texels = await decodeRegion(units, level, top, left, bottom, right, scales);
      found.push({ texels: toBase64(texels), planes: units.planes, asked });
    }
    return found;
    """
    asked = []
    for region, found in zip(REGIONS, run(code, payload=told(payload), regions=REGIONS), strict=True):
        level, top, left, bottom, right = region
        expected = planes_of_ours(payload, device, Region(top, left, bottom, right, level))
        texels = numbers(found["texels"], "<f2").reshape(-1, *expected.shape[1:], 4)
        planes = np.moveaxis(texels, 3, 1).reshape(-1, *expected.shape[1:])[: found["planes"]]
        np.testing.assert_allclose(planes, expected, rtol=2**-11, atol=2e-6 * np.abs(expected).max(initial=0))
        asked.append(found["asked"])
    # What is not shown is not read.
    assert max(asked[1:]) < 0.9 * asked[0]
    assert asked[5] < asked[4] < asked[3] < 0.2 * asked[0]


def test_damaged_payloads_are_refused_or_decoded_as_the_program_does(cases, device):
    """Neither hangs, for the scripts are given seconds; bytes beyond the ends would make other planes than ours."""
    rng = np.random.default_rng(11)
    damaged, expected = [], []
    while len(damaged) < 240:
        changed = mutations.damage(cases[rng.integers(len(cases))], cases, rng)
        payload = mutations.seal(mutations.seal_units(changed) if rng.random() < 0.8 else changed)
        try:
            encoded = Encoded.from_bytes(payload)
        except PayloadError:
            continue
        if encoded.codec != "klt" or encoded.body[:1] != b"\4" or np.prod(encoded.shape) > 1 << 22:
            continue
        damaged.append({"body": base64.b64encode(encoded.body).decode(), "shape": encoded.shape})
        try:
            expected.append(planes_of_ours(payload, device))
        except PayloadError:
            expected.append(None)
    code = """
    const found = [];
    for (const each of data.payloads) {
      try {
        found.push({ planes: toBase64(await wholePlanes(open(each))) });
      } catch (error) {
        found.push({ refused: error.name, message: error.message });
      }
    }
    return found;
    """
    results = run(code, payloads=damaged)
    assert {each["refused"] for each in results if "refused" in each} == {"Refused"}
    both = 0
    for found, planes in zip(results, expected, strict=True):
        if planes is not None:
            # The program refuses tables of axes as well, which the page never reads.
            assert "planes" in found, found
            np.testing.assert_allclose(
                numbers(found["planes"]), planes.ravel(), rtol=0, atol=1e-5 * np.abs(planes).max(initial=1.0)
            )
            both += 1
    assert both > 10
    assert sum("refused" in each for each in results) > 80


def test_a_large_view_without_planes(device):
    """There are no streams then, although the image has more than one unit."""
    encoded = encode(np.zeros((1, 3, 90000, 1), np.float32), codec_class("klt")(step=0.1), device)
    code = """
    const units = open(data.payload);
    const texels = await decodeRegion(units, 2, 0, 5, 1, 300, []);
    return [units.planes, units.count > 1, units.together, (await wholePlanes(units)).length, texels.length];
    """
    assert run(code, payload=told(encoded.to_bytes())) == [0, True, False, 0, 0]


def test_few_bytes_cannot_claim_much():
    shapes = [[1, 1 << 20, 1 << 20, 1], [1681, 1 << 20, 1, 3], [4, 1 << 16, 1 << 15, 3], [1, 0, 5, 1]]
    bodies = [base64.b64encode(open_payload(path.read_bytes()).body).decode() for path in FROZEN]
    code = """
    return data.shapes.flatMap((shape) => data.bodies.map((body) => {
      try { open({ body, shape }); return "taken"; } catch (error) { return error.name; }
    }));
    """
    assert set(run(code, shapes=shapes, bodies=bodies)) == {"Refused"}


def test_unit_streams_begin_where_the_program_says(device):
    payload = mutations.make_units(14, device)
    encoded = Encoded.from_bytes(payload)
    body = drop_padding(encoded.body, encoded.shape)
    code = "const units = open(data.payload); return { starts: [...units.index.starts], count: units.count };"
    found = run(code, payload=told(payload))
    assert found["count"] == len(list_units(*encoded.shape[1:3]))
    np.testing.assert_array_equal(found["starts"], parse_body(body, encoded.shape).stored.start_t)


def test_halves_are_rounded_as_numpy_rounds():
    rng = np.random.default_rng(0)
    values = (rng.standard_normal(4000) * 2.0 ** rng.integers(-30, 16, 4000)).astype(np.float32)
    values = np.concatenate([values, np.float32([0, -0.0, 1e9, -1e9, 65504, 65519, 6e-8, 2.9e-8, 1 / 3])])
    found = run("return data.values.map((value) => clrelight.toHalf(value));", values=values.tolist())
    expected = np.clip(values, -65504, 65504).astype(np.float16)
    np.testing.assert_array_equal(np.uint16(found).view(np.float16), expected)
    back = run("return data.bits.map((bits) => clrelight.fromHalf(bits));", bits=found)
    np.testing.assert_array_equal(np.float32(back), expected.astype(np.float32))
