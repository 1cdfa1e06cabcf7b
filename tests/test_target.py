import json
import os

import numpy as np
import pytest

from clrelight.cli.app import run
from clrelight.codec import decode, encode
from clrelight.codec.formats.klt import Klt
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.jobs.fit import fit
from clrelight.jobs.target import TOLERANCE, encode_to_quality
from clrelight.store import read_encoded, write_fit, write_stack
from datasets_synth.ring import render_ring


@pytest.fixture(scope="module")
def stack():
    return render_ring(size=40, lights=80)


@pytest.fixture(scope="module")
def coefficients(stack):
    return fit(stack, "spline", 6, holdout=5)


def pooled_psnr(coeffs_khwc, stack, lights):
    """PSNR in float64 NumPy, clipped to the range of the photographs."""
    basis = evaluate_basis(stack.directions_i3[lights], 6)
    images = np.clip(np.einsum("ik,khwc->ihwc", basis, coeffs_khwc.astype(np.float64)), 0.0, 1.0)
    return -10 * np.log10(np.mean((images - stack.images_ihwc[lights] / 255.0) ** 2))


@pytest.mark.parametrize("codec", ["klt", "wavelet"])
@pytest.mark.parametrize("loss", [0.5, 2.0])
def test_a_target_is_met_at_the_lights_not_fitted(stack, coefficients, device, codec, loss):
    held = np.flatnonzero(np.arange(80) % 5 == 4)
    target = pooled_psnr(coefficients.coeffs_khwc, stack, held) - loss
    encoded, trials, why = encode_to_quality(coefficients, stack, target, codec=codec, device=device)
    reached = pooled_psnr(decode(encoded.to_bytes(), device), stack, held)
    assert target <= reached <= target + TOLERANCE
    assert "within" in why
    assert min(t.byte_count for t in trials if t.psnr >= target) == encoded.encoded_bytes


def test_a_target_beyond_the_fit_is_refused(stack, coefficients, device):
    with pytest.raises(InputError, match="the fit itself reaches"):
        encode_to_quality(coefficients, stack, 90.0, device=device)


def test_only_codecs_with_one_number_take_a_target(stack, coefficients, device):
    with pytest.raises(InputError, match="klt and wavelet"):
        encode_to_quality(coefficients, stack, 5.0, codec="half", device=device)


@pytest.fixture
def files(tmp_path, stack, coefficients):
    write_stack(tmp_path / "stack.h5", stack)
    write_fit(tmp_path / "fit.h5", coefficients)
    return tmp_path


def test_encode_by_bytes_by_quality_and_in_a_basis(files, capsys, device, stack, coefficients):
    names = {name: str(files / f"{name}.h5") for name in ("stack", "fit", "a", "b", "c", "d")}
    assert run(["encode", names["fit"], names["a"], "--bytes", "8k", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["codec"] == "klt"
    assert 0.97 * 8000 <= os.stat(names["a"]).st_size == facts["bytes_on_disk"] <= 8000

    assert run(["encode", names["fit"], names["b"], "--target-psnr", "18", "--stack", names["stack"], "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert 18.0 <= facts["psnr"]["pooled_holdout"] <= 18.0 + TOLERANCE

    assert run(["encode", names["fit"], names["c"], "--basis", "whitened", "--codec", "s3tc", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["config"] == {"codec": "s3tc", "options": {}}

    assert run(["encode", names["fit"], names["d"], "--codec", "wavelet", "--bytes", "20k", "--json"]) == 0
    assert 0.97 * 20000 <= json.loads(capsys.readouterr().out)["bytes_on_disk"] <= 20000

    # Relighting goes straight from the planes; it is what the coefficients give.
    image = str(files / "relit.exr")
    assert run(["relight", names["a"], image, "--light", "0.3,0.2,0.8"]) == 0
    import OpenImageIO

    light = np.array([[0.3, 0.2, 0.8]])
    coeffs = decode(read_encoded(names["a"])[0], device).astype(np.float64)
    expected = np.einsum("ik,khwc->hwc", evaluate_basis(light / np.linalg.norm(light), 6), coeffs)
    np.testing.assert_allclose(OpenImageIO.ImageBuf(image).get_pixels(), expected, atol=2e-5)


@pytest.mark.parametrize(
    "options",
    [
        ["--target-psnr", "20"],
        ["--target-psnr", "nan", "--stack", "STACK"],
        ["--target-psnr", "20", "--stack", "STACK", "--rate", "1"],
        ["--basis", "klt", "--codec", "whitened"],
        ["--basis", "whitened", "--codec", "klt"],
        ["--codec", "s3tc", "--bytes", "10k"],
        ["--bytes", "10"],
        ["--codec", "klt", "--step", "1e9"],
    ],
)
def test_requests_that_make_no_sense_are_one_line(files, capsys, options):
    options = [str(files / "stack.h5") if option == "STACK" else option for option in options]
    assert run(["encode", str(files / "fit.h5"), str(files / "out.h5"), *options]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (files / "out.h5").exists()


def test_klt_beats_the_plain_basis_at_equal_bytes(coefficients, stack, device):
    held = np.flatnonzero(np.arange(80) % 5 == 4)
    small = encode(coefficients.coeffs_khwc, Klt(byte_budget=6000), device)
    rate = 8.0 * small.encoded_bytes / coefficients.coeffs_khwc.size
    from clrelight.codec.formats.wavelet import Wavelet

    plain = encode(coefficients.coeffs_khwc, Wavelet(rate=rate, allocation="global"), device)
    ours, theirs = (pooled_psnr(decode(e, device), stack, held) for e in (small, plain))
    assert ours > theirs + 0.3
