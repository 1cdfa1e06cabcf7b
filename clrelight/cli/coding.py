"""``clrelight encode`` and ``decode``."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import ByteCount, device_option, given, json_option
from clrelight.cli.output import decibel, print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.quality import measure, psnr_lines
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.codec import Codec, Encoded


_MAX_DECIBELS = 1000.0


@click.command()
@click.argument("fit_file", metavar="FIT", type=click.Path())
@click.argument("out", type=click.Path())
@click.option("--codec", help="half, s3tc, bc6h, uniform, wavelet, jpeg2000, vq, cpca or klt; default s3tc, or klt.")
@click.option(
    "--basis",
    type=click.Choice(["sh", "whitened", "klt"]),
    default="sh",
    show_default=True,
    help="Coordinates that are coded: as fitted; in the metric of the image; its principal axes.",
)
@click.option("--bytes", "byte_budget", type=ByteCount(), metavar="BYTES", help="Use no more (klt, wavelet, jpeg2000).")
@click.option("--target-psnr", type=float, metavar="DB", help="Fewest bytes for this pooled PSNR; needs --stack.")
@click.option("--rate", type=float, help="Bits per coefficient (wavelet, jpeg2000: default 4; klt: default 0.1).")
@click.option("--step", type=float, help="Quantiser step, instead of a rate (klt).")
@click.option(
    "--transfer",
    type=click.Choice(["linear", "srgb"]),
    help="Errors are alike in radiance, or in sRGB code values (klt); default: what the fit's stack holds.",
)
@click.option("--bits", type=int, help="Bits per code (uniform, cpca), log2 of the codebook (vq); default 8.")
@click.option("--allocation", help="How wavelet rates are shared: map (each alike) or global (one step for all).")
@click.option("--levels", type=int, help="Levels of the wavelet transform (wavelet); default 3.")
@click.option("--clusters", type=int, help="Clusters of pixels (cpca); default 16.")
@click.option("--components", type=int, help="Axes of a cluster (cpca); default 8.")
@click.option("--planes", type=int, help="Principal axes kept (basis klt); default: all but 1e-4 of the energy.")
@click.option("--block", type=int, help="Side of the coded blocks, 0 for pixels (vq); default 0.")
@click.option("--clamp", is_flag=True, default=None, help="Clamp what a half float cannot hold (half, bc6h).")
@click.option("--stack", type=click.Path(), help="Measure PSNR of the decoded result against this stack.")
@device_option
@json_option
def encode(
    fit_file: str,
    out: str,
    codec: str | None,
    basis: str,
    byte_budget: int | None,
    target_psnr: float | None,
    stack: str | None,
    device: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Compress the coefficients of a fit.

    A target is met at the lights of the stack that the fit has not seen, where there are any, else at those it has.

    \b
    Example:
      clrelight encode fit.h5 enc.h5 --codec wavelet --rate 1 --stack stack.h5
      clrelight encode fit.h5 enc.h5 --bytes 20k
      clrelight encode fit.h5 enc.h5 --target-psnr 31 --stack stack.h5
    """
    import numpy as np

    from clrelight import codec as codecs
    from clrelight.device import open_device
    from clrelight.experiment.noise import coding_psnr, predicted_psnr
    from clrelight.experiment.target import encode_to_quality
    from clrelight.store import check_output, open_stack, read_fit, write_encoded

    if target_psnr is not None and not abs(target_psnr) <= _MAX_DECIBELS:
        raise InputError(f"--target-psnr must be a number of decibels, got {target_psnr}")
    wanted = given(**options)
    if target_psnr is not None and (
        stack is None
        or byte_budget is not None
        or wanted
        or basis == "whitened"
        or (basis == "klt" and codec not in (None, "klt"))
    ):
        raise InputError("--target-psnr needs --stack to measure against, and no other size or option beside it")
    if byte_budget is not None and ("rate" in wanted or "step" in wanted):
        raise InputError("--bytes says the size already, leave out --rate and --step")
    codec = codec or ("klt" if basis == "klt" or byte_budget or target_psnr is not None else "s3tc")
    if target_psnr is None and byte_budget is None:
        _choose(codec, basis, wanted)  # says what is wrong before the fit is read
    check_output(out, [fit_file] if stack is None else [fit_file, stack])
    opened = open_device(device)
    seconds: dict[str, float] = {}
    since = time.perf_counter()
    coefficients = read_fit(fit_file).to_float32()
    seconds["read"] = time.perf_counter() - since
    notes: list[str] = []
    noise = None
    since = time.perf_counter()
    if target_psnr is not None and stack is not None:
        with open_stack(stack) as source:
            encoded, trials, why = encode_to_quality(coefficients, source, target_psnr, codec=codec, device=opened)
        notes += [f"tried {t.byte_count} bytes: {t.psnr:.2f} dB" for t in trials]
        notes.append(f"took {encoded.encoded_bytes} bytes: {why}")
    else:
        if byte_budget is not None:
            size = float(np.prod(coefficients.coeffs_khwc.shape, dtype=np.int64))
            key, value = ("byte_budget", byte_budget) if codec == "klt" else ("rate", 8.0 * byte_budget / size)
            wanted[key] = value
        chosen = _choose(codec, basis, wanted).for_transfer(coefficients.transfer)
        with progress_bar(f"encoding {codec}"):
            noise = codecs.predict_noise(coefficients.coeffs_khwc, chosen, opened)
            seconds["predict"] = time.perf_counter() - since
            since = time.perf_counter()
            encoded = codecs.encode(coefficients.coeffs_khwc, chosen, opened)
    seconds["encode"] = time.perf_counter() - since
    facts = {"file": out, **_size_facts(encoded), "config": dict(encoded.config), "device": opened.info.label}
    facts["notes"] = notes
    facts["coding_noise"] = predicted_psnr(noise)
    if stack is not None:
        with open_stack(stack) as source:
            with progress_bar("decoding"):
                since = time.perf_counter()
                # From the bytes alone, as `decode` will do it.
                decoded = replace(coefficients, coeffs_khwc=codecs.decode(encoded.to_bytes(), opened))
                seconds["decode"] = time.perf_counter() - since
            since = time.perf_counter()
            facts["coding_noise"] = coding_psnr(noise, coefficients.coeffs_khwc, decoded.coeffs_khwc)
            facts["psnr"] = measure(decoded, source, opened)
            seconds["measure"] = time.perf_counter() - since
    since = time.perf_counter()
    write_encoded(out, encoded, coefficients)
    seconds["write"] = time.perf_counter() - since
    facts["seconds"] = seconds
    if as_json:
        print_json(facts)
        return
    clamped = int(encoded.info.get("clamped", 0))
    print_notes(notes + ([f"{clamped} coefficients were clamped"] if clamped else []))
    print_facts(
        {
            "encoded": out,
            **_size_lines(encoded),
            **_noise_line(facts["coding_noise"]),
            **psnr_lines(facts.get("psnr")),
            "time": seconds_line(seconds),
        }
    )


@click.command()
@click.argument("encoded_file", metavar="ENC", type=click.Path())
@click.argument("out", type=click.Path())
@device_option
@json_option
def decode(encoded_file: str, out: str, device: str | None, as_json: bool) -> None:
    """Turn an encoded file back into a fit.

    \b
    Example:
      clrelight decode enc.h5 decoded.h5
    """
    from clrelight import codec as codecs
    from clrelight.device import open_device
    from clrelight.store import check_output, read_encoded, write_fit

    check_output(out, [encoded_file])
    opened = open_device(device)
    seconds: dict[str, float] = {}
    since = time.perf_counter()
    encoded, source = read_encoded(encoded_file)
    seconds["read"] = time.perf_counter() - since
    with progress_bar(f"decoding {encoded.codec}"):
        since = time.perf_counter()
        coefficients = source.to_map(codecs.decode(encoded, opened))
        seconds["decode"] = time.perf_counter() - since
    since = time.perf_counter()
    write_fit(out, coefficients)
    seconds["write"] = time.perf_counter() - since
    if as_json:
        print_json({"file": out, **_size_facts(encoded), "seconds": seconds, "device": opened.info.label})
        return
    print_facts({"fit": out, **_size_lines(encoded), "time": seconds_line(seconds)})


def _choose(codec: str, basis: str, options: dict[str, Any]) -> Codec:
    """Return the codec in a basis; InputError where the two do not go together."""
    from clrelight.codec import codec_class

    options = dict(options)
    if basis == "whitened":
        return codec_class("whitened").from_config({"codec": codec, "options": options})
    planes = options.pop("planes", None)
    if basis == "klt" and codec != "klt":
        config = {"codec": codec, "options": options, "planes": planes}
        return codec_class("principal").from_config(config)
    if planes is not None:
        raise InputError("--planes is for --basis klt with a codec other than klt, which chooses its own")
    return codec_class(codec).from_config(options)


def _size_facts(encoded: Encoded) -> dict[str, Any]:
    return {
        "codec": encoded.codec,
        "encoded_bytes": encoded.encoded_bytes,
        "bits_per_coefficient": encoded.bits_per_coefficient,
        **encoded.info,
    }


def _noise_line(noise: dict[str, float]) -> dict[str, str]:
    words = {"coding_psnr_predicted": "predicted", "coding_psnr": "measured"}
    known = [f"{decibel(noise[key])} {word}" for key, word in words.items() if not math.isnan(noise.get(key, math.nan))]
    return {"noise": ", ".join(known) + " (of coding alone, below the peak)"} if known else {}


def _size_lines(encoded: Encoded) -> dict[str, str]:
    lines = {
        "codec": encoded.codec,
        "size": f"{encoded.encoded_bytes} bytes, {encoded.bits_per_coefficient:.4g} bit per coefficient",
    }
    if "entropy_bits" in encoded.info:
        lines["entropy"] = f"{encoded.info['entropy_bits']:.4g} bit per coefficient (estimate)"
    return lines


COMMANDS = (encode, decode)
