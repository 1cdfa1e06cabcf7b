"""``clrelight psnr``, and how commands print quality."""

from __future__ import annotations

from typing import Any

import click

from clrelight.cli.engines import engine_options, is_shared, run_shared
from clrelight.cli.options import device_option, json_option, perceptual_option
from clrelight.cli.output import decibel, print_report
from clrelight.cli.progress import progress_bar


@click.command()
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("stack", type=click.Path())
@perceptual_option
@engine_options
@device_option
@json_option
def psnr(
    fitted: str,
    stack: str,
    perceptual: bool,
    engine: str | None,
    jobs: int | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Measure PSNR of a fit or an encoded file against a stack.

    Lights that the fit has not seen are measured apart.

    \b
    Example:
      clrelight psnr enc.h5 stack.h5
      clrelight psnr enc.h5 stack.h5 --perceptual
      clrelight psnr large.h5 stack.h5 --jobs 2
    """
    from clrelight.jobs.measure import measure
    from clrelight.jobs.report import Report

    report = Report(facts={"file": fitted})
    with progress_bar("measuring") as bar:
        if is_shared(engine, jobs):
            asked = {"stack": stack, "perceptual": perceptual}
            run_shared("psnr", fitted, None, asked, engine, jobs, device, bar, report)
        else:
            measure(fitted, stack, perceptual=perceptual, device=device, progress=bar, report=report)
    print_report(report, as_json, psnr_lines(report.psnr))


def psnr_lines(quality: dict[str, Any] | None) -> dict[str, str]:
    """Return PSNRs as people read them."""
    lines = {}
    for name, title in (("fitted", "PSNR"), ("holdout", "PSNR, held out")):
        if quality and f"mean_{name}" in quality:
            mean, pooled = quality[f"mean_{name}"], quality[f"pooled_{name}"]
            over = "lights"
            if f"identical_{name}" in quality:
                # A black image is met exactly: one is enough to make the mean of all infinite.
                mean = quality[f"mean_others_{name}"]
                over = f"the lights whose images are not identical ({quality[f'identical_{name}']} are)"
            error = f" ± {quality[f'error_{name}']:.2f}" if f"error_{name}" in quality else ""
            lines[title] = f"{decibel(mean)} mean over {over}, {decibel(pooled)}{error} pooled"
    for name, title in (("fitted", "seen"), ("holdout", "seen, held out")):
        if quality and f"flip_{name}" in quality:
            flip, colour = (
                f"{quality[f'{figure}_{name}']:.{digits}f} ± {quality[f'{figure}_error_{name}']:.{digits}f}"
                for figure, digits in (("flip", 4), ("colour", 2))
            )
            lines[title] = f"FLIP {flip}, CIEDE2000 {colour}, at {quality[f'perceived_{name}']} lights"
    if quality and "sampled" in quality:
        lines["measured at"] = f"{quality['sampled']:.1%} of the pixels"
    if quality and "distance_median_holdout" in quality:
        median, largest = quality["distance_median_holdout"], quality["distance_largest_holdout"]
        lines["held out"] = f"{median:.1f}° from the nearest fitted light (median), {largest:.1f}° at most"
    return lines


COMMANDS = (psnr,)
