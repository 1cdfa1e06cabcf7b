import json
import struct

import numpy as np
import pytest

from clrelight.codec import codec_class, decode, decode_view, encode
from clrelight.errors import InputError, PayloadError
from clrelight.harmonics.basis import evaluate_basis
from tests.commands import call, succeed
from tests.mutations import check_large_claims
from tests.test_codec_klt import image_error, smooth_map

OPTIONS = {"uniform": {"bits": 12}, "wavelet": {"rate": 8.0}, "jpeg2000": {"rate": 8.0}}


def principal(codec, planes=None, **options):
    return codec_class("principal").from_config({"codec": codec, "options": options, "planes": planes})


@pytest.mark.parametrize("inner", ["half", "s3tc", "bc6h", "uniform", "wavelet", "jpeg2000", "cpca", "vq"])
def test_every_codec_gives_the_coefficients_back(device, inner):
    coeffs = smooth_map(4, 32, 32, 3)
    options = OPTIONS.get(inner, {})
    encoded = encode(coeffs, principal(inner, **options), device)
    error = image_error(coeffs, decode(encoded.to_bytes(), device), 4)
    plain = encode(coeffs, codec_class(inner).from_config(options), device)
    # What the axes left out hold 1e-4 of the energy, which the inner codec's own error adds to.
    left_out = 0.01 * image_error(coeffs, np.zeros_like(coeffs), 4)
    assert error < 1.2 * image_error(coeffs, decode(plain, device), 4) + 1.1 * left_out
    assert encoded.encoded_bytes < 0.75 * plain.encoded_bytes or inner in ("wavelet", "jpeg2000", "cpca", "vq")
    directions = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.36, 0.48, 0.8]])
    direct = np.einsum("ik,khwc->ihwc", evaluate_basis(directions, 4), decode(encoded, device).astype(np.float64))
    images = decode_view(encoded, device).relight(directions, device)
    assert np.abs(images - direct).max() < 1e-5 * np.abs(direct).max()


def test_axes_left_out_cost_what_they_hold(device):
    coeffs = smooth_map(4, 24, 24, 3)
    errors, sizes = [], []
    for planes in (2, 5, 12, 25):
        encoded = encode(coeffs, principal("half", planes), device)
        assert encoded.info["planes"] == planes
        errors.append(image_error(coeffs, decode(encoded, device), 4))
        sizes.append(encoded.encoded_bytes)
    assert errors == sorted(errors, reverse=True)
    assert sizes == sorted(sizes)
    # All axes are a change of basis: only half's rounding and float16 axes are left, which the maps are solved for.
    assert errors[-1] < 1e-3 * np.abs(coeffs).max()


def test_a_rate_counts_the_table(device):
    encoded = encode(smooth_map(6, 40, 48, 3), principal("wavelet", rate=1.0), device)
    assert 0.98 <= encoded.bits_per_coefficient <= 1.0
    with pytest.raises(InputError, match="table of axes"):
        encode(smooth_map(6, 8, 8, 1), principal("wavelet", rate=0.01), device)


@pytest.mark.parametrize("value", [0.0, 1e-30, 1e30])
def test_constant_maps_of_every_size(device, value):
    coeffs = np.full((9, 8, 8, 3), value, np.float32)
    decoded = decode(encode(coeffs, principal("s3tc"), device), device)
    assert image_error(coeffs, decoded, 2) <= 1e-3 * value


@pytest.mark.parametrize(
    "config",
    [
        {"codec": "klt"},
        {"codec": "principal"},
        {"codec": "whitened"},
        {"planes": 0},
        {"planes": 1.5},
        {"options": {"bits": 3}},
    ],
)
def test_options_are_checked(config):
    with pytest.raises(InputError):
        codec_class("principal").from_config(config)


def test_bodies_that_cannot_be(device):
    encoded = encode(smooth_map(2, 8, 8, 3), principal("half", 3), device)
    body, kind = encoded.body, codec_class("principal")
    damaged = [
        b"",
        body[:5],
        body[:40],
        b"\x04hulf" + body[5:],
        b"\x03klt" + body[5:],
        body[:5] + struct.pack("<H", 0) + body[7:],
        body[:5] + struct.pack("<H", 500) + body[7:],
        body[:7] + struct.pack("<e", np.inf) + body[9:],
        body[:7] + struct.pack("<e", np.nan) + body[9:],
    ]
    for wrong in damaged:
        with pytest.raises(PayloadError):
            kind.decode_body(wrong, encoded.shape, device)
    check_large_claims(device, kind, [body, b"", bytes(40)])


def test_command(tmp_path):
    succeed("synth", "ring", tmp_path / "stack.h5", "--size", 16, "--lights", 36)
    succeed("fit", tmp_path / "stack.h5", tmp_path / "fit.h5", "--degree", 3)
    words = ["encode", tmp_path / "fit.h5", tmp_path / "enc.h5", "--basis", "klt"]
    told = succeed(*words, "--codec", "s3tc", "--planes", 4, "--json").json
    assert (told["codec"], told["planes"]) == ("principal", 4)
    assert told["config"] == {"codec": "s3tc", "options": {}, "planes": 4}
    succeed("relight", tmp_path / "enc.h5", tmp_path / "relit.png", "--light", "0.3,0.2,0.8")
    succeed("decode", tmp_path / "enc.h5", tmp_path / "back.h5")
    assert json.loads(succeed(*words, "--json").out)["codec"] == "klt"
    (tmp_path / "enc.h5").unlink()
    for wrong in (["--codec", "klt", "--planes", 4], ["--codec", "s3tc", "--planes", 0], ["--codec", "whitened"]):
        ended = call(*words, *wrong)
        assert (ended.code, ended.err.count("\n"), (tmp_path / "enc.h5").exists()) == (2, 1, False), ended.err
