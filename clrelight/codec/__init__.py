"""Codecs: a coefficient map to bytes and back. One file per codec; importing this package registers them all."""

from clrelight.codec.bc6h import Bc6h
from clrelight.codec.cpca import Cpca
from clrelight.codec.half import Half
from clrelight.codec.jpeg2000 import Jpeg2000
from clrelight.codec.registry import Codec, Encoded, codec_class, codec_ids, decode, encode, register
from clrelight.codec.s3tc import S3tc
from clrelight.codec.uniform import Uniform
from clrelight.codec.vq import Vq

__all__ = [
    "Bc6h",
    "Codec",
    "Cpca",
    "Encoded",
    "Half",
    "Jpeg2000",
    "S3tc",
    "Uniform",
    "Vq",
    "codec_class",
    "codec_ids",
    "decode",
    "encode",
    "register",
]
