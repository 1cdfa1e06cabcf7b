"""Codecs: a coefficient map to bytes and back. One file per codec; importing this package registers them all."""

from clrelight.codec.factored import Factored
from clrelight.codec.half import Half
from clrelight.codec.klt import Klt
from clrelight.codec.registry import Codec, Encoded, codec_class, codec_ids, decode, encode, register
from clrelight.codec.s3tc import S3tc
from clrelight.codec.uniform import Uniform
from clrelight.codec.wavelet import Wavelet
from clrelight.codec.whitened import Whitened

__all__ = [
    "Codec",
    "Encoded",
    "Factored",
    "Half",
    "Klt",
    "S3tc",
    "Uniform",
    "Wavelet",
    "Whitened",
    "codec_class",
    "codec_ids",
    "decode",
    "encode",
    "register",
]
