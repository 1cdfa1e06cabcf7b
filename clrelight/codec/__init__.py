"""Codecs: a coefficient map to bytes and back. One file per codec; importing this package registers them all."""

from clrelight.codec.encoded import Encoded
from clrelight.codec.factored import Factored
from clrelight.codec.formats.bc6h import Bc6h
from clrelight.codec.formats.cpca import Cpca
from clrelight.codec.formats.half import Half
from clrelight.codec.formats.jpeg2000 import Jpeg2000
from clrelight.codec.formats.klt import Klt
from clrelight.codec.formats.principal_maps import PrincipalMaps
from clrelight.codec.formats.s3tc import S3tc
from clrelight.codec.formats.uniform import Uniform
from clrelight.codec.formats.vq import Vq
from clrelight.codec.formats.wavelet import Wavelet
from clrelight.codec.formats.whitened import Whitened
from clrelight.codec.registry import (
    Codec,
    PartsCodec,
    array_source,
    bytes_to_decode,
    codec_class,
    codec_ids,
    decode,
    decode_stream,
    encode,
    encode_stream,
    predict_noise,
    predict_noise_of,
    register,
)
from clrelight.codec.viewing import bent_regions, decode_regions, decode_shown, decode_view

__all__ = [
    "Bc6h",
    "Codec",
    "Cpca",
    "Encoded",
    "Factored",
    "Half",
    "Jpeg2000",
    "Klt",
    "PartsCodec",
    "PrincipalMaps",
    "S3tc",
    "Uniform",
    "Vq",
    "Wavelet",
    "Whitened",
    "array_source",
    "bent_regions",
    "bytes_to_decode",
    "codec_class",
    "codec_ids",
    "decode",
    "decode_regions",
    "decode_shown",
    "decode_stream",
    "decode_view",
    "encode",
    "encode_stream",
    "predict_noise",
    "predict_noise_of",
    "register",
]
