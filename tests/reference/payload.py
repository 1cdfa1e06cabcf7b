"""Payloads by docs/bitstream.md: the wrapper, and what codecs share."""

import math
import zlib
from collections import namedtuple

Payload = namedtuple("Payload", "codec shape body")


class Refused(Exception):
    """The page says that no decoder takes this."""


def require(condition, what):
    if not condition:
        raise Refused(what)


def open_payload(payload):
    require(payload[:4] == b"CLRE" and payload[4] == 1, "magic or version")
    at = 6 + payload[5]
    shape = tuple(int.from_bytes(payload[at + 4 * i : at + 4 * i + 4], "little") for i in range(4))
    length = int.from_bytes(payload[at + 16 : at + 24], "little")
    checksum = int.from_bytes(payload[at + 24 : at + 28], "little")
    body = payload[at + 28 :]
    require(len(body) == length, "length")
    require(zlib.crc32(payload[: at + 24] + body) == checksum, "checksum")
    require(all(1 <= side <= 2**20 for side in shape) and shape[3] <= 1024, "shape")
    require(math.prod(shape) <= 2**32 and math.isqrt(shape[0]) ** 2 == shape[0], "shape")
    return Payload(payload[6:at].decode("ascii"), shape, body)


def without_minimum_padding(body, shape):
    beyond = math.prod(shape) - 2**24
    if beyond <= 0:
        return body
    least = max(4, -(-beyond // 2**17))
    require(len(body) >= least, "least size")
    zeros = int.from_bytes(body[-4:], "little")
    end = len(body) - 4 - zeros
    require(end >= 0 and not any(body[end:-4]) and (zeros == 0 or len(body) == least), "least size")
    return body[:end]


def without_padding(body, end, shape):
    least = -(-math.prod(shape) // 1024)
    require(len(body) == max(end, least) and not any(body[end:]), "padding")
    return body[:end]


def unpack(packed, count, bits):
    """Return codes of some bits each, lowest bit first."""
    whole = int.from_bytes(packed, "little")
    return [whole >> bits * i & (1 << bits) - 1 for i in range(count)]
