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
import zlib
from functools import partial
from pathlib import Path

import click
import numpy as np

from clrelight.codec import codec_class, codec_ids, decode, decode_view, encode
from clrelight.codec.entropy.unit_index import pack_index
from clrelight.codec.formats.klt_units import HEAD_SIZE, VERSION
from clrelight.codec.formats.wavelet_units import VERSION as WAVELET_VERSION
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
WEIGHTS = {"wavelet": 2.5, "klt": 4.0, "whitened/wavelet": 1.5}
"""How often a family is taken beside the others, which count 1."""
FREE_BYTES, BYTES_EACH = 1 << 28, 32
"""Address space that decoding may take, and for each coefficient claimed: eight float32 arrays."""
FREE_SECONDS, SECONDS_EACH = 20.0, 1e-6
"""A decoder that takes longer hangs: a thousand times the usual, whatever else the machine does."""
WRAPPERS = ("principal", "whitened")
"""Codecs that hold another one."""
UNITS_SEALED = 0.7
"""The part of them whose inner checksums fit too."""
FROZEN = Path(__file__).resolve().parent / "frozen"
RELIT = 3
"""Every so many payloads are relit too, by what needs no coefficients."""
LIGHT = np.array([[0.0, 0.6, 0.8]])


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
    front = (
        _front_of_klt(body, shape) if name == b"klt" else _front_of_wavelet(body, shape) if name == b"wavelet" else 0
    )
    if front == 0 or not 0 < shape[1] * shape[2] <= 1 << 18 or len(body) < front:
        return payload
    place = front
    while place < len(body) - 1 and body[place] >= 128:
        place += 1
    stream = body[place + 5 :]  # behind the last byte of the length and two checksums
    index = pack_index([stream])
    return payload[:at] + body[:front] + index + _crc(body[:front] + index) + stream


def _front_of_klt(body, shape):
    """Return what stands before the index of a klt body of version 4 with one stream, else 0."""
    count, tables = struct.unpack_from("<HxI", body, 8)
    return HEAD_SIZE + tables if body[0] == VERSION and count else 0


def _front_of_wavelet(body, shape):
    """Return what stands before the index of a wavelet body of version 6 with one stream, else 0."""
    n_coeff, channel = shape[0], shape[3]
    version, _, flags, group = struct.unpack_from("<BBBH", body)
    if version != WAVELET_VERSION or not flags & 1 or len(body) < 5 + 2 * n_coeff or n_coeff > group:
        return 0
    count = sum(body[5 + 2 * k : 7 + 2 * k] != b"\xff\xff" for k in range(n_coeff))
    rotations = (count if flags & 8 else 1) if flags & 4 else 0
    angles = rotations * (channel * (channel - 1) // 2) * (2 if flags & 16 else 1)
    return 5 + 2 * n_coeff + angles + (5 * channel * count if flags & 2 else 0) if count else 0


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
    return plain + [f"{outer}/{name}" for outer in WRAPPERS for name in plain if name != "klt"]


def make_payloads(family, device):
    """Return one payload for each shape and setting of a family, and those that are frozen: of old versions too."""
    outer, _, inner = family.partition("/")
    settings = OPTIONS.get(inner or outer, [{}])
    payloads = [] if inner else [path.read_bytes() for path in sorted(FROZEN.glob(f"{outer}*.bin"))]
    for options in settings[: 1 if inner else None]:
        config = {"codec": inner, "options": options} if inner else options
        for number, shape in enumerate(SHAPES):
            coeffs = np.random.default_rng(number).standard_normal(shape).astype(np.float32)
            payloads.append(encode(coeffs, codec_class(outer).from_config(config), device).to_bytes())
    return payloads


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
            tally.run(case, partial(self._check, payload, sealed, number % RELIT == 0), first="payloads")
        return tally

    def _check(self, payload, sealed, relit):
        """Return whether a damaged payload was decoded; AssertionError where it should not have been."""
        claimed = _claimed(payload)
        with bounded(FREE_BYTES + BYTES_EACH * claimed, FREE_SECONDS + SECONDS_EACH * claimed):
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
