"""``clrelight encode`` and ``decode``."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import device_option, given, json_option, whole_number
from clrelight.cli.output import print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.quality import measure, psnr_lines
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.codec import Codec, Encoded

_MAX_DECIBELS = 1000.0


@click.command()
@click.argument("fit_file", metavar="FIT", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--codec",
    default="s3tc",
    show_default=True,
    help="half, s3tc, bc6h, uniform, wavelet, jpeg2000, klt, cpca, vq or whitened.",
)
@click.option("--rate", type=float, help="Bits per coefficient (wavelet, jpeg2000: default 4; klt: default 0.1).")
@click.option("--byte-budget", type=whole_number(1), help="Bytes not to be passed, instead of a rate (klt).")
@click.option("--step", type=float, help="Quantiser step, instead of a rate (klt).")
@click.option("--bits", type=int, help="Bits per code (uniform, cpca), log2 of the codebook (vq); default 8.")
@click.option("--allocation", help="How wavelet rates are shared: map (each alike) or global (one step for all).")
@click.option("--levels", type=int, help="Levels of the wavelet transform (wavelet); default 3.")
@click.option("--clusters", type=int, help="Clusters of pixels (cpca); default 16.")
@click.option("--components", type=int, help="Axes of a cluster (cpca); default 8.")
@click.option("--block", type=int, help="Side of the coded blocks, 0 for pixels (vq); default 0.")
@click.option("--clamp", is_flag=True, default=None, help="Clamp what a half float cannot hold (half, bc6h).")
@click.option("--inner", metavar="CODEC", help="The codec that codes whitened maps, with its options (whitened).")
@click.option("--target-psnr", type=float, metavar="DB", help="As few bytes as this quality takes (klt, wavelet).")
@click.option("--stack", type=click.Path(), help="Measure PSNR of the decoded result against this stack.")
@device_option
@json_option
def encode(
    fit_file: str,
    out: str,
    codec: str,
    stack: str | None,
    inner: str | None,
    target_psnr: float | None,
    device: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Compress the coefficients of a fit.

    A target is met at the lights of the stack that the fit has not seen, where there are any, else at those it has.

    \b
    Example:
      clrelight encode fit.h5 enc.h5 --codec wavelet --rate 1 --stack stack.h5
      clrelight encode fit.h5 enc.h5 --codec klt --target-psnr 30 --stack stack.h5
    """
    from clrelight import codec as codecs
    from clrelight.device import open_device
    from clrelight.experiment.target import encode_to_quality
    from clrelight.store import check_output, open_stack, read_fit, write_encoded

    chosen = _make_codec(codec, inner, given(**options))
    if target_psnr is not None and not abs(target_psnr) <= _MAX_DECIBELS:
        raise InputError(f"--target-psnr must be a number of decibels, got {target_psnr}")
    if target_psnr is not None and (stack is None or given(**options) or inner):
        raise InputError("--target-psnr is measured on --stack FILE, and chooses the options of the codec itself")
    check_output(out, [fit_file] if stack is None else [fit_file, stack])
    opened = open_device(device)
    seconds: dict[str, float] = {}
    since = time.perf_counter()
    coefficients = read_fit(fit_file)
    seconds["read"] = time.perf_counter() - since
    notes = []
    with progress_bar(f"encoding {codec}"):
        since = time.perf_counter()
        if target_psnr is None or stack is None:
            encoded = codecs.encode(coefficients.coeffs_khwc, chosen, opened)
        else:
            with open_stack(stack) as source:
                encoded, trials, why = encode_to_quality(coefficients, source, target_psnr, codec=codec, device=opened)
            notes.append(f"{len(trials)} trials: {why}")
        seconds["encode"] = time.perf_counter() - since
    clamped = int(encoded.info.get("clamped", 0))
    notes += [f"{clamped} coefficients were clamped"] if clamped else []
    facts: dict[str, Any] = {"file": out, **_size_facts(encoded), "config": dict(encoded.config)}
    facts |= {"notes": notes, "device": opened.info.label}
    if stack is not None:
        with open_stack(stack) as source:
            with progress_bar("decoding"):
                since = time.perf_counter()
                # From the bytes alone, as `decode` will do it.
                decoded = replace(coefficients, coeffs_khwc=codecs.decode(encoded.to_bytes(), opened))
                seconds["decode"] = time.perf_counter() - since
            since = time.perf_counter()
            facts["psnr"] = measure(decoded, source, opened)
            seconds["measure"] = time.perf_counter() - since
    since = time.perf_counter()
    write_encoded(out, encoded, coefficients)
    seconds["write"] = time.perf_counter() - since
    facts["seconds"] = seconds
    if as_json:
        print_json(facts)
        return
    print_notes(notes)
    print_facts(
        {"encoded": out, **_size_lines(encoded), **psnr_lines(facts.get("psnr")), "time": seconds_line(seconds)}
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


def _make_codec(codec_id: str, inner: str | None, options: dict[str, Any]) -> Codec:
    from clrelight.codec import codec_class

    if inner is None:
        return codec_class(codec_id).from_config(options)
    if codec_id != "whitened":
        raise InputError(f"--inner belongs to the codec whitened, not to {codec_id}")
    return codec_class(codec_id).from_config({"codec": inner, "options": options})


def _size_facts(encoded: Encoded) -> dict[str, Any]:
    return {
        "codec": encoded.codec,
        "encoded_bytes": encoded.encoded_bytes,
        "bits_per_coefficient": encoded.bits_per_coefficient,
        **encoded.info,
    }


def _size_lines(encoded: Encoded) -> dict[str, str]:
    lines = {
        "codec": encoded.codec,
        "size": f"{encoded.encoded_bytes} bytes, {encoded.bits_per_coefficient:.4g} bit per coefficient",
    }
    if "entropy_bits" in encoded.info:
        lines["entropy"] = f"{encoded.info['entropy_bits']:.4g} bit per coefficient (estimate)"
    return lines


COMMANDS = (encode, decode)
