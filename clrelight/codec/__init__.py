"""Codecs: a coefficient map to bytes and back. One file per codec; importing this package registers them all."""

from clrelight.codec.bc6h import Bc6h
from clrelight.codec.cpca import Cpca
from clrelight.codec.factored import Factored
from clrelight.codec.half import Half
from clrelight.codec.jpeg2000 import Jpeg2000
from clrelight.codec.klt import Klt
from clrelight.codec.principal_maps import PrincipalMaps
from clrelight.codec.registry import (
    Codec,
    Encoded,
    codec_class,
    codec_ids,
    decode,
    decode_view,
    encode,
    predict_noise,
    register,
)
from clrelight.codec.s3tc import S3tc
from clrelight.codec.uniform import Uniform
from clrelight.codec.vq import Vq
from clrelight.codec.wavelet import Wavelet
from clrelight.codec.whitened import Whitened

__all__ = [
    "Bc6h",
    "Codec",
    "Cpca",
    "Encoded",
    "Factored",
    "Half",
    "Jpeg2000",
    "Klt",
    "PrincipalMaps",
    "S3tc",
    "Uniform",
    "Vq",
    "Wavelet",
    "Whitened",
    "codec_class",
    "codec_ids",
    "decode",
    "decode_view",
    "encode",
    "predict_noise",
    "register",
]
