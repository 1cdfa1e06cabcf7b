"""Damaged payloads: every decoder must refuse them, or decode them to finite numbers, soon and in little memory.

``python -m tests.mutations --count 20000 --seed 1`` damages that many payloads of all codecs. A case depends on the
seed, its codec and its number alone, so ``--only klt --first 1234 --count 1`` repeats one.
"""

from __future__ import annotations

import binascii
import faulthandler
import itertools
import math
import struct
import sys
import time
import zlib
from functools import partial
from pathlib import Path

import click
import numpy as np

from clrelight.codec import codec_class, codec_ids, decode, decode_view, encode
from clrelight.codec.entropy.unit_index import pack_index
from clrelight.codec.entropy.units import count_units
from clrelight.codec.formats.inner import name_inner
from clrelight.codec.formats.klt_units import HEAD_SIZE, VERSION, count_streams
from clrelight.codec.formats.wavelet_units import VERSION as WAVELET_VERSION
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.whitening import AXES
from clrelight.device import open_device
from clrelight.errors import PayloadError
from tests import campaign
from tests.campaign import Tally, bounded

SHAPES = [(4, 5, 9, 3), (4, 6, 7, 1), (1, 6, 7, 1), (4, 1, 13, 2)]
OPTIONS = {
    "wavelet": [{"rate": 8.0}, {"rate": 14.0, "allocation": "global"}, {"rate": 40.0}],
    "klt": [{"step": 0.05}, {"step": 0.002}, {"step": 0.03, "transfer": "srgb"}],
    "uniform": [{"bits": 7}, {"bits": 8}],
    "jpeg2000": [{"rate": 60.0}],
    "cpca": [{"clusters": 4, "components": 2, "bits": 5}],
    "vq": [{"bits": 5}, {"bits": 5, "block": 2}],
}
UNITS = "klt 4"
"""A family of its own, of what its units hang on."""
UNITS_CASES = [
    ((1, 9, 14, 1), {"step": 0.02}),
    ((1, 1, 1, 1), {"step": 0.02}),
    ((4, 12, 9, 3), {"step": 0.01}),
    ((9, 7, 16, 4), {"step": 0.05}),
    ((16, 5, 9, 3), {"step": 0.05, "metric": "perceptual"}),
    ((25, 6, 8, 3), {"step": 0.004, "transfer": "srgb", "metric": "perceptual"}),
    ((36, 3, 31, 1), {"step": 0.004, "transfer": "srgb"}),
    ((49, 4, 5, 2), {"step": 0.05}),
    ((64, 33, 2, 1), {"step": 0.1}),
    ((81, 5, 6, 3), {"step": 0.3}),
    ((4, 40, 33, 3), {"rate": 1.0, "metric": "perceptual"}),
    ((1, 70, 140, 4), {"rate": 0.3}),
    ((9, 64, 64, 1), {"rate": 0.1}),
    ((1, 1, 300, 3), {"step": 1e-4}),
    ((1, 3, 90000, 1), {"rate": 0.06}),
    ((4, 520, 513, 1), {"rate": 0.02}),
    ((1, 600, 450, 3), {"rate": 0.02, "metric": "perceptual"}),
]
"""Shapes and settings: degrees 0 to 8, 1 to 4 channels; the last three have streams for each of many units."""
WEIGHTS = {"wavelet": 2.5, "klt": 4.0, UNITS: 2.0, "whitened/wavelet": 3.0, "principal/wavelet": 1.5}
"""How often a family is taken beside the others, which count 1."""
FREE_BYTES, BYTES_EACH = 1 << 28, 32
"""Address space that decoding may take, and for each coefficient claimed: eight float32 arrays."""
UNITS_FREE_BYTES = 1 << 27
"""Of `UNITS`."""
FREE_SECONDS, SECONDS_EACH = 20.0, 1e-6
"""A decoder that takes longer hangs: a thousand times the usual, whatever else the machine does."""
UNITS_FREE_SECONDS = 2.0
"""Of `UNITS`, of processors' time: then a payload has failed, which another process beside cannot cause."""
WRAPPERS = ("principal", "whitened")
"""Codecs that hold another one."""
UNITS_SEALED = 0.7
"""The part of them whose inner checksums fit too."""
FROZEN = Path(__file__).resolve().parent / "frozen"
RELIT = 3
"""Every so many payloads are relit too, by what needs no coefficients."""
LIGHT = np.array([[0.0, 0.6, 0.8]])
_SMALL_MAPS = (1, 4, 9)
"""Coefficients of whitened maps whose inner checksums are mended."""


def seal(payload):
    """Return `payload` with the length and the checksum of its own header and body."""
    at = 6 + payload[5] + 24 if len(payload) > 5 else len(payload)
    if len(payload) < at + 4:
        return payload
    head = payload[: at - 8] + struct.pack("<Q", len(payload) - at - 4)
    return head + struct.pack("<I", zlib.crc32(payload[at + 4 :], zlib.crc32(head))) + payload[at + 4 :]


def seal_units(payload):
    """Return `payload` with the checksums that bodies in units have inside, so that its units are decoded."""
    at = 6 + payload[5] + 28 if len(payload) > 5 else len(payload)
    body, name = payload[at:], payload[6 : at - 28]
    if len(body) < HEAD_SIZE:
        return payload
    shape = struct.unpack_from("<4I", payload, at - 28)
    if name == b"whitened" and body[:8] == name_inner("wavelet") and shape[0] in _SMALL_MAPS:
        at, body, name = at + 8, body[8:], b"wavelet"
        shape = (hemisphere_metric(shape[0], AXES).inverse_kj.shape[1], *shape[1:])
    fronts = {b"klt": _front_of_klt, b"wavelet": _front_of_wavelet}
    front, count = fronts[name](body, shape) if name in fronts else (0, 0)
    if front == 0 or not 0 < shape[1] * shape[2] <= 1 << 20 or len(body) < front:
        return payload
    streams = _split_streams(body, front, count)
    if not streams:
        return payload
    index = pack_index(streams)
    return payload[:at] + body[:front] + index + _crc(body[:front] + index) + b"".join(streams)


def _split_streams(body, place, count):
    """Return streams as an index at a place says, the last one with all that is left; none where that is cut short."""
    sizes = []
    for _ in range(count):
        size = shift = 0
        while place < len(body) and body[place] >= 128:
            size, place, shift = size | (body[place] & 127) << shift, place + 1, shift + 7
        if place >= len(body):
            return []
        sizes.append(size | body[place] << shift)
        place += 3  # behind the last byte of the length, and a checksum
    place += 2
    streams = []
    for size in sizes[:-1]:
        streams.append(body[place : place + size])
        place += len(streams[-1])
    return [*streams, body[place:]]


def _front_of_klt(body, shape):
    """Return the bytes before the index of a klt body of version 4, and its streams; 0 where it is none."""
    count, tables = struct.unpack_from("<HxI", body, 8)
    return (HEAD_SIZE + tables, count_streams(shape)) if body[0] == VERSION and count else (0, 0)


def _front_of_wavelet(body, shape):
    """Return the bytes before the index of a wavelet body of version 6, and its streams; 0 where it is none."""
    n_coeff, channel = shape[0], shape[3]
    version, _, flags, group = struct.unpack_from("<BBBH", body)
    if version != WAVELET_VERSION or not group or len(body) < 5 + 2 * n_coeff:
        return 0, 0
    count = sum(body[5 + 2 * k : 7 + 2 * k] != b"\xff\xff" for k in range(n_coeff))
    rotations = (count if flags & 8 else 1) if flags & 4 else 0
    angles = rotations * (channel * (channel - 1) // 2) * (2 if flags & 16 else 1)
    front = 5 + 2 * n_coeff + angles + (5 * channel * count if flags & 2 else 0)
    return (front, -(-count // group) * (1 if flags & 1 else count_units(*shape[1:3]))) if count else (0, 0)


def _crc(content):
    return struct.pack("<H", binascii.crc_hqx(content, 0))


def check_large_claims(device, codec_class, bodies):
    """Small bodies that claim gigabytes must be refused before anything is allocated."""
    for shape in [(1, 1 << 16, 1 << 15, 1), (1 << 16, 256, 128, 1), (1, 1, 1, 1 << 20), (64, 1 << 20, 1, 32)]:
        for body in bodies:
            try:
                codec_class.decode_body(body, shape, device)
            except PayloadError:
                continue
            raise AssertionError(f"{len(body)} bytes were taken for shape {shape}")


def families():
    """Return the names under which payloads are counted: the codecs, and each of them inside each of `WRAPPERS`."""
    plain = [name for name in codec_ids() if name not in WRAPPERS]
    return [*plain, UNITS] + [f"{outer}/{name}" for outer in WRAPPERS for name in plain if name != "klt"]


def make_payloads(family, device):
    """Return one payload for each shape and setting of a family, and those that are frozen: of old versions too."""
    if family == UNITS:
        made = [make_units(number, device) for number in range(len(UNITS_CASES))]
        return [*made[:-3] * 4, *made[-3:]]  # large ones take ten times as long
    outer, _, inner = family.partition("/")
    settings = OPTIONS.get(inner or outer, [{}])
    payloads = [] if inner else [path.read_bytes() for path in sorted(FROZEN.glob(f"{outer}*.bin"))]
    for options in settings[: 1 if inner else None]:
        config = {"codec": inner, "options": options} if inner else options
        for number, shape in enumerate(SHAPES):
            payloads.append(make_payload(outer, config, shape, number, device))
    return payloads


def make_units(number, device):
    """Return the payload of a case of `UNITS`."""
    shape, options = UNITS_CASES[number]
    return make_payload("klt", options, shape, number, device, lit=True)


def make_payload(codec, config, shape, number, device, lit=False):
    """Return a payload of noise; `lit` is mostly positive, as radiance is."""
    coeffs = np.random.default_rng(number).standard_normal(shape).astype(np.float32)
    if lit:  # most radiance is positive, and has a code value
        coeffs = coeffs * np.float32(0.2)
        coeffs[0] += 1.5 + 0.7 * np.sin(np.arange(shape[2]) / 40).astype(np.float32)[:, None]
    return encode(coeffs, codec_class(codec).from_config(config), device).to_bytes()


def damage(payload, others, rng):
    """Return a damaged payload; `others` lend their bodies."""
    changed = bytearray(payload)
    name_end = 6 + changed[5]
    body = name_end + 28
    for _ in range(rng.integers(1, 4)):
        # Half of what is hit are the few bytes of the shape and the first tables; the codec's name stays mostly.
        tables = min(body + 60, len(changed))
        first, end = (name_end, tables) if rng.random() < 0.5 else (min(body, len(changed) - 1), len(changed))
        at = int(rng.integers(first, max(end, first + 1)))
        length = int(min(1 + rng.geometric(0.1), len(changed) - at))
        match rng.choice(_KINDS, p=_SHARES):
            case "byte":
                changed[at] = rng.integers(256)
            case "bit":
                changed[at] ^= 1 << int(rng.integers(8))
            case "extreme":
                changed[at : at + length] = bytes([rng.choice([0, 1, 0x7F, 0x80, 0xFF])]) * length
            case "cut":
                del changed[max(at, body) :]
            case "delete":
                del changed[at : at + length]
            case "insert":
                changed[at:at] = rng.bytes(length)
            case "size":
                axis = name_end + 4 * int(rng.integers(4))
                changed[axis : axis + 4] = struct.pack("<I", _absurd_size(changed[axis : axis + 4], rng))
            case "swap":
                other = others[rng.integers(len(others))]
                other_body = other[6 + other[5] + 28 :]
                if rng.random() < 0.5:
                    changed[body:] = other_body
                else:
                    changed[at:] = other_body[at - body if at > body else 0 :]
        if len(changed) <= name_end:
            break
    if rng.random() < 0.04:
        name = str(rng.choice([*codec_ids(), "zip", ""])).encode()
        changed[5:name_end] = bytes([len(name)]) + name
    return bytes(changed)


_KINDS = ("byte", "bit", "extreme", "cut", "delete", "insert", "size", "swap")
_SHARES = (0.3, 0.22, 0.1, 0.08, 0.06, 0.06, 0.1, 0.08)


def _absurd_size(now, rng):
    (size,) = struct.unpack("<I", now.ljust(4, b"\0"))
    choices = [0, 1, 2, size + 1, size - 1, 2 * size, 1 << int(rng.integers(32)), (1 << int(rng.integers(32))) - 1]
    # Numbers of coefficients are squares.
    return int(rng.choice([*choices, int(rng.integers(1, 1025)) ** 2])) & 0xFFFFFFFF


class Campaign:
    """The payloads to damage, and the device that decodes them."""

    def __init__(self, only):
        self.device = open_device("cpu")
        self.payloads = {family: make_payloads(family, self.device) for family in families()}
        self.others = [payload for payloads in self.payloads.values() for payload in payloads]
        self.payloads = {family: payloads for family, payloads in self.payloads.items() if only in family}
        for payload in itertools.chain(*self.payloads.values()):
            decode(payload, self.device)  # builds the kernels, which takes memory of its own

    def counts(self, count):
        """Return how many of `count` payloads each family gets, `count` or a little more in all."""
        weights = {family: WEIGHTS.get(family, 1.0) for family in self.payloads}
        return {family: math.ceil(count * weight / sum(weights.values())) for family, weight in weights.items()}

    def run(self, family, numbers, seed, trace):
        """Damage and decode payloads; an exception that is no PayloadError is a failure."""
        tally = Tally("payloads", "unsealed", "refused", "decoded")
        for number in numbers:
            rng = np.random.default_rng([seed, zlib.crc32(family.encode()), number])
            original = self.payloads[family][number % len(self.payloads[family])]
            sealed = rng.random() < 0.9
            payload = damage(original, self.others, rng)
            if sealed:
                payload = seal(seal_units(payload) if rng.random() < UNITS_SEALED else payload)
            if payload == original:
                continue
            if trace:
                print(f"{family} {number}", file=sys.stderr, flush=True)
            case = f"--only {family} --first {number} --seed {seed}"
            tally.counts["unsealed"] += not sealed
            check = partial(self._check, payload, sealed, number % RELIT == 0, family == UNITS)
            tally.run(case, check, first="payloads")
        return tally

    def _check(self, payload, sealed, relit, strict):
        """Return whether a damaged payload was decoded; AssertionError where it should not have been."""
        claimed = _claimed(payload)
        free_bytes = UNITS_FREE_BYTES if strict else FREE_BYTES
        start = time.process_time()
        with bounded(free_bytes + BYTES_EACH * claimed, FREE_SECONDS + SECONDS_EACH * claimed):
            try:
                values = decode(payload, self.device)
            except PayloadError:
                values = None
            else:
                assert sealed, "damage went unnoticed although the checksum was left as it was"
                assert values.dtype == np.float32
                assert values.size == claimed
                assert np.isfinite(values).all()
            images = self._relight(payload) if relit else None
            if images is not None:
                assert images.dtype == np.float32
                assert images.shape == (1, *struct.unpack_from("<3I", payload, 10 + payload[5]))
                assert np.isfinite(images).all()
        spent = time.process_time() - start
        assert not strict or spent < UNITS_FREE_SECONDS + SECONDS_EACH * claimed, f"{spent:.1f} s"
        return ["refused" if values is None else "decoded"]

    def _relight(self, payload):
        """Return an image made without coefficients, which takes the same bytes another way; None if refused."""
        try:
            view = decode_view(payload, self.device)
            return None if view is None else view.relight(LIGHT, self.device)
        except PayloadError:
            return None


def _claimed(payload):
    """Return the coefficients that a header claims, as far as the length of the body allows to claim them."""
    at = 6 + payload[5] if len(payload) > 5 else 0
    if len(payload) < at + 28:
        return 0
    return min(math.prod(struct.unpack_from("<4I", payload, at)), (1 << 24) + (len(payload) << 17))


@click.command()
@campaign.options(20000, "Payloads")
@click.option("--trace", is_flag=True, help="Name each payload before it is decoded, to find what ends the process.")
def main(count, seed, only, first, trace):
    """Damage payloads of every codec and decode them; print one JSON object for each family, exit 1 on a failure."""
    faulthandler.enable()
    payloads = Campaign(only)
    campaign.conclude(
        "family",
        (
            (family, payloads.run(family, range(first, first + share), seed, trace))
            for family, share in payloads.counts(count).items()
        ),
    )


if __name__ == "__main__":
    main(prog_name="python -m tests.mutations")
