"""``clrelight encode`` and ``decode``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import click

from clrelight.cli.completion import known_codecs
from clrelight.cli.engines import engine_options, is_shared, run_shared
from clrelight.cli.options import (
    ByteCount,
    device_option,
    is_given,
    json_option,
    level_option,
    memory_option,
    preview_option,
    region_option,
    salvage_option,
)
from clrelight.cli.output import decibel, make_report, preview_line, print_report
from clrelight.cli.progress import progress_bar
from clrelight.cli.psnr import psnr_lines


@click.command()
@click.argument("fit_file", metavar="FIT", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--codec",
    shell_complete=known_codecs,
    help="half, s3tc, bc6h, uniform, wavelet, jpeg2000, vq, cpca or klt; default: klt where a size or a quality is "
    "asked for (--rate, --step, --bytes, --target-psnr), else s3tc.",
)
@click.option(
    "--basis",
    type=click.Choice(["sh", "whitened", "klt"]),
    default="sh",
    show_default=True,
    help="Coordinates that are coded: as fitted; in the metric of the image; its principal axes.",
)
@click.option(
    "--bytes", "byte_budget", type=ByteCount(), metavar="BYTES", help="The file takes no more (klt, wavelet, jpeg2000)."
)
@click.option("--target-psnr", type=float, metavar="DB", help="Fewest bytes for this pooled PSNR; needs --stack.")
@click.option("--rate", type=float, help="Bits per coefficient (wavelet, jpeg2000: default 4; klt: default 0.1).")
@click.option("--step", type=float, help="Quantiser step, instead of a rate (klt).")
@click.option(
    "--transfer",
    type=click.Choice(["linear", "srgb"]),
    help="Errors are alike in radiance, or in sRGB code values (klt); default: what the fit's stack holds.",
)
@click.option(
    "--metric",
    type=click.Choice(["radiance", "perceptual"]),
    help="What errors cost (klt): the same in every channel (default), or what they are in CIELAB.",
)
@click.option("--bits", type=int, help="Bits per code (uniform, cpca), log2 of the codebook (vq); default 8.")
@click.option("--allocation", help="How wavelet rates are shared: map (each alike) or global (one step for all).")
@click.option("--clusters", type=int, help="Clusters of pixels (cpca); default 16.")
@click.option("--components", type=int, help="Axes of a cluster (cpca); default 8.")
@click.option("--planes", type=int, help="Principal axes kept (basis klt); default: all but 1e-4 of the energy.")
@click.option("--block", type=int, help="Side of the coded blocks, 0 for pixels (vq); default 0.")
@click.option("--clamp", is_flag=True, default=None, help="Clamp what a half float cannot hold (half, bc6h).")
@click.option("--stack", type=click.Path(), help="Measure PSNR of the decoded result against this stack.")
@preview_option
@memory_option("256MiB", "parts of the map")
@device_option
@json_option
@click.pass_context
def encode(
    context: click.Context,
    fit_file: str,
    out: str,
    codec: str | None,
    basis: str,
    byte_budget: int | None,
    target_psnr: float | None,
    stack: str | None,
    preview: str | None,
    memory: int,
    device: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Compress the coefficients of a fit.

    A target is met at the lights of the stack that the fit has not seen, where there are any, else at those it has.
    Maps that --memory does not hold are taken in parts, beside a temporary copy on the disk of OUT.

    \b
    Example:
      clrelight encode fit.h5 enc.h5 --codec wavelet --rate 1 --stack stack.h5
      clrelight encode fit.h5 enc.h5 --bytes 20k --preview enc.png
      clrelight encode fit.h5 enc.h5 --target-psnr 31 --stack stack.h5
    """
    from clrelight.jobs.encode import encode as run_encode

    report = make_report(as_json)
    with progress_bar("encoding") as bar:
        run_encode(
            fit_file,
            codec,
            out=out,
            basis=basis,
            bytes=byte_budget,
            target_psnr=target_psnr,
            stack=stack,
            preview=preview,
            memory=memory if is_given(context, "memory") else None,
            device=device,
            progress=bar,
            report=report,
            **options,
        )
    noise = _noise_line(report.facts["coding_noise"])
    lines = {"encoded": out, **preview_line(report.facts), **_size_lines(report.facts)}
    print_report(report, as_json, {**lines, **noise, **psnr_lines(report.psnr)})


@click.command()
@click.argument("encoded_file", metavar="ENC", type=click.Path())
@click.argument("out", type=click.Path())
@region_option
@level_option
@salvage_option
@memory_option("256MiB", "parts of the map")
@engine_options
@device_option
@json_option
@click.pass_context
def decode(
    context: click.Context,
    encoded_file: str,
    out: str,
    region: tuple[int, int, int, int] | None,
    level: int,
    salvage: bool,
    memory: int,
    engine: str | None,
    jobs: int | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Turn an encoded file, here or behind a URL, back into a fit, or a part of one.

    \b
    Example:
      clrelight decode enc.h5 decoded.h5
      clrelight decode enc.h5 small.h5 --level 2
      clrelight decode large.h5 decoded.h5 --jobs 2
      clrelight decode https://host/enc.h5 part.h5 --region 0,0,512,512
    """
    from clrelight.jobs.decode import decode as run_decode

    report = make_report(as_json)
    with progress_bar("decoding") as bar:
        given = memory if is_given(context, "memory") else None
        if is_shared(engine, jobs):
            asked = {"region": region, "level": level or None, "salvage": salvage, "memory": given}
            run_shared("decode", encoded_file, out, asked, engine, jobs, device, bar, report)
        else:
            run_decode(
                encoded_file,
                out=out,
                region=region,
                level=level,
                salvage=salvage,
                memory=given,
                device=device,
                progress=bar,
                report=report,
            )
    print_report(report, as_json, {"fit": out, **_size_lines(report.facts)})


def _noise_line(noise: dict[str, float]) -> dict[str, str]:
    words = {"coding_psnr_predicted": "predicted", "coding_psnr": "measured"}
    known = [f"{decibel(noise[key])} {word}" for key, word in words.items() if not math.isnan(noise.get(key, math.nan))]
    return {"noise": ", ".join(known) + " (of coding alone, below the peak)"} if known else {}


def _size_lines(facts: Mapping[str, Any]) -> dict[str, str]:
    lines = {
        "codec": facts["codec"],
        "size": f"{facts['encoded_bytes']} bytes, {facts['bits_per_coefficient']:.4g} bit per coefficient",
    }
    if "bytes_on_disk" in facts:
        lines["file"] = f"{facts['bytes_on_disk']} bytes"
    if "entropy_bits" in facts:
        lines["entropy"] = f"{facts['entropy_bits']:.4g} bit per coefficient (estimate)"
    return lines


COMMANDS = (encode, decode)
