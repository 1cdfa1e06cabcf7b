"""``clrelight fit``, ``encode``, ``decode`` and ``psnr``."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import DegreeType, device_option, given, json_option, memory_option
from clrelight.cli.output import decibel, print_facts, print_json, print_notes, progress_bar, seconds_line

if TYPE_CHECKING:
    from clrelight.codec import Encoded
    from clrelight.dataset import CoefficientMap, LightStack
    from clrelight.device import Device


@click.command()
@click.argument("stack", type=click.Path())
@click.argument("out", type=click.Path())
@click.option(
    "--method", default="cls", show_default=True, help="project, uls, sloan, cls, ceb, ceb-crossing, spline or auto."
)
@click.option("--degree", type=DegreeType(), default=6, show_default=True, help="Largest SH degree, or auto.")
@click.option("--holdout", type=int, metavar="K", help="Keep every K-th light out of the fit and measure there too.")
@click.option("--energy", type=float, help="Factor on the bound E_c of cls and ceb; 1 is the paper's.")
@click.option("--iterations", type=int, help="Steps of the search for lambda (cls); default 32.")
@click.option("--solver", help="Search for lambda (cls): bisection or newton.")
@click.option("--fill", help="Lower hemisphere (project): zero or mirror.")
@click.option("--lam", type=float, help="Smoothing of spline; default: by generalised cross-validation.")
@click.option("--per", help="What shares one lambda (spline): stack or channel.")
@click.option("--weights", default="uniform", show_default=True, help="uniform or solid-angle.")
@click.option("--sampling", default="hemisphere", show_default=True, help="hemisphere or scattered (section V-D).")
@click.option("--measure/--no-measure", default=True, help="Whether to measure PSNR after fitting.")
@memory_option("256MiB", "one tile of the fit")
@device_option
@json_option
def fit(
    stack: str,
    out: str,
    method: str,
    degree: int | str,
    holdout: int | None,
    weights: str,
    sampling: str,
    measure: bool,
    memory: int,
    device: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Fit SH coefficients to every pixel of a stack.

    \b
    Example:
      clrelight fit stack.h5 fit.h5 --method cls --degree 6 --holdout 5
      clrelight fit stack.h5 fit.h5 --method auto --degree auto
    """
    from clrelight.dataset import split_lights
    from clrelight.device import open_device
    from clrelight.fit.run import fit_tiles, prepare_fit
    from clrelight.store import create_fit, open_fit, open_stack

    opened = open_device(device)
    with open_stack(stack) as source:
        fitted, held = split_lights(source.n_light, holdout)
        chosen = source if holdout is None else source.select(fitted)
        prepared = prepare_fit(
            chosen, method, degree, options=given(**options), weights=weights, sampling=sampling, device=opened
        )
        report = prepared.report
        with (
            progress_bar(f"fitting {prepared.method.title}") as bar,
            create_fit(
                out,
                degree=prepared.degree,
                image_shape=source.image_shape,
                method=prepared.method.id,
                peak=source.peak,
                transfer=source.transfer,
                directions_i3=chosen.directions_i3,
                config=prepared.config,
                name=source.name,
                has_lambda=prepared.method.has_lambda,
                has_rank=prepared.method.has_rank,
            ) as sink,
        ):
            for tile in fit_tiles(prepared, memory_bytes=memory):
                since = time.perf_counter()
                rows = slice(tile.first, tile.end)
                sink.coeffs_khwc[:, rows] = tile.coeffs_khwc
                if sink.lambda_hwc is not None and tile.lambda_hwc is not None:
                    sink.lambda_hwc[rows] = tile.lambda_hwc
                if sink.rank_hwc is not None and tile.rank_hwc is not None:
                    sink.rank_hwc[rows] = tile.rank_hwc
                report.add("write", since)
                bar(tile.end, source.image_shape[0])
        facts: dict[str, Any] = {
            "file": out,
            "method": prepared.method.id,
            "degree": prepared.degree,
            "n_coeff": (prepared.degree + 1) ** 2,
            "n_light": len(fitted),
            "n_holdout": len(held),
            "config": dict(prepared.config),
            "condition": report.condition,
            "device": opened.info.label,
            "notes": report.notes,
        }
        if prepared.choice is not None:
            facts["choice"] = prepared.choice.to_config()
        if measure:
            since = time.perf_counter()
            with open_fit(out) as coefficients:
                facts["psnr"] = _measure(coefficients, source, opened, holdout)
            report.add("measure", since)
        facts["seconds"] = report.seconds
    if as_json:
        print_json(facts)
        return
    print_notes(report.notes)
    print_facts(
        {
            "fit": out,
            "method": f"{prepared.method.title}, degree {prepared.degree}, {len(fitted)} lights",
            "condition": f"{report.condition:.3g}",
            **_psnr_lines(facts.get("psnr")),
            "time": seconds_line(report.seconds),
            "device": opened.info.label,
        }
    )


@click.command()
@click.argument("fit_file", metavar="FIT", type=click.Path())
@click.argument("out", type=click.Path())
@click.option("--codec", default="s3tc", show_default=True, help="half, s3tc, uniform or wavelet.")
@click.option("--bits", type=int, help="Bits per code (uniform); default 8.")
@click.option("--rate", type=float, help="Bits per coefficient (wavelet); default 4.")
@click.option("--allocation", help="How wavelet rates are shared: map (each alike) or global (one step for all).")
@click.option("--levels", type=int, help="Levels of the wavelet transform; default 3.")
@click.option("--clamp", is_flag=True, default=None, help="Clamp what half cannot hold instead of refusing it (half).")
@click.option("--stack", type=click.Path(), help="Measure PSNR of the decoded result against this stack.")
@device_option
@json_option
def encode(
    fit_file: str, out: str, codec: str, stack: str | None, device: str | None, as_json: bool, **options: Any
) -> None:
    """Compress the coefficients of a fit.

    \b
    Example:
      clrelight encode fit.h5 enc.h5 --codec wavelet --rate 1 --stack stack.h5
    """
    from clrelight import codec as codecs
    from clrelight.device import open_device
    from clrelight.store import open_stack, read_fit, write_encoded

    opened = open_device(device)
    chosen = codecs.codec_class(codec).from_config(given(**options))
    seconds: dict[str, float] = {}
    since = time.perf_counter()
    coefficients = read_fit(fit_file)
    seconds["read"] = time.perf_counter() - since
    since = time.perf_counter()
    encoded = codecs.encode(coefficients.coeffs_khwc, chosen, opened)
    seconds["encode"] = time.perf_counter() - since
    facts = {"file": out, **_size_facts(encoded), "config": dict(encoded.config), "device": opened.info.label}
    if stack is not None:
        since = time.perf_counter()
        decoded = replace(coefficients, coeffs_khwc=codecs.decode(encoded.to_bytes(), opened))
        seconds["decode"] = time.perf_counter() - since
        with open_stack(stack) as source:
            since = time.perf_counter()
            facts["psnr"] = _measure(decoded, source, opened)
            seconds["measure"] = time.perf_counter() - since
    since = time.perf_counter()
    write_encoded(out, encoded, coefficients)
    seconds["write"] = time.perf_counter() - since
    facts["seconds"] = seconds
    if as_json:
        print_json(facts)
        return
    print_facts(
        {"encoded": out, **_size_lines(encoded), **_psnr_lines(facts.get("psnr")), "time": seconds_line(seconds)}
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
    from clrelight.store import read_encoded, write_fit

    opened = open_device(device)
    encoded, source = read_encoded(encoded_file)
    since = time.perf_counter()
    coefficients = source.to_map(codecs.decode(encoded, opened))
    seconds = {"decode": time.perf_counter() - since}
    since = time.perf_counter()
    write_fit(out, coefficients)
    seconds["write"] = time.perf_counter() - since
    if as_json:
        print_json({"file": out, **_size_facts(encoded), "seconds": seconds, "device": opened.info.label})
        return
    print_facts({"fit": out, **_size_lines(encoded), "time": seconds_line(seconds)})


@click.command()
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("stack", type=click.Path())
@device_option
@json_option
def psnr(fitted: str, stack: str, device: str | None, as_json: bool) -> None:
    """Measure PSNR of a fit or an encoded file against a stack.

    Lights that the fit has not seen are measured apart.

    \b
    Example:
      clrelight psnr enc.h5 stack.h5
    """
    from clrelight.device import open_device
    from clrelight.store import open_stack

    opened = open_device(device)
    coefficients = load_coefficients(fitted, opened)
    since = time.perf_counter()
    with open_stack(stack) as source:
        quality = _measure(coefficients, source, opened)
    seconds = {"measure": time.perf_counter() - since}
    if as_json:
        print_json({"file": fitted, "psnr": quality, "seconds": seconds, "device": opened.info.label})
        return
    print_facts({**_psnr_lines(quality), "time": seconds_line(seconds)})


def load_coefficients(path: str, device: Device) -> CoefficientMap:
    """Return the coefficients of a fit file, or of an encoded file after decoding."""
    from clrelight.codec import decode as decode_bytes
    from clrelight.store import file_schema, read_encoded, read_fit

    if file_schema(path).startswith("encoded/"):
        encoded, source = read_encoded(path)
        return source.to_map(decode_bytes(encoded, device))
    return read_fit(path)


def _measure(
    coefficients: CoefficientMap, stack: LightStack, device: Device, holdout: int | None = None
) -> dict[str, float]:
    import numpy as np

    from clrelight.dataset import split_lights
    from clrelight.metrics import measure_errors, summarize_errors

    if holdout is None:
        closest = np.max(stack.directions_i3 @ coefficients.directions_i3.T, axis=1)
        fitted, held = np.flatnonzero(closest > 1 - 1e-12), np.flatnonzero(closest <= 1 - 1e-12)
    else:
        fitted, held = split_lights(stack.n_light, holdout)
    with progress_bar("measuring") as bar:
        mse_i = measure_errors(coefficients, stack, device=device, progress=bar)
    quality: dict[str, float] = {}
    for name, lights in (("fitted", fitted), ("holdout", held)):
        if len(lights):
            measured = summarize_errors(mse_i[lights])
            quality[f"mean_{name}"], quality[f"pooled_{name}"] = measured.psnr_mean, measured.psnr_pooled
    return quality


def _psnr_lines(quality: dict[str, float] | None) -> dict[str, str]:
    lines = {}
    for name, title in (("fitted", "PSNR"), ("holdout", "PSNR, held out")):
        if quality and f"mean_{name}" in quality:
            mean, pooled = quality[f"mean_{name}"], quality[f"pooled_{name}"]
            lines[title] = f"{decibel(mean)} mean over lights, {decibel(pooled)} pooled"
    return lines


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


COMMANDS = (fit, encode, decode, psnr)
