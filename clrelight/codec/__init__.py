"""Codecs: a coefficient map to bytes and back. One file per codec; importing this package registers them all."""

from clrelight.codec.registry import Codec, Encoded, codec_class, codec_ids, decode, encode, register
from clrelight.codec.wavelet import Wavelet

__all__ = ["Codec", "Encoded", "Wavelet", "codec_class", "codec_ids", "decode", "encode", "register"]
