"""The benchmark of the RTI field: SynthRTI and RealRTI, at lights that no fit has seen.

    CLRELIGHT_DATA=data python -m benchmarks.rti [--quick] [--stacks GLOB] [--markdown docs/which-basis.md]

SynthRTI is fitted to Dome and measured on Test, whose lights lie between the rings; of RealRTI every fifth light is
kept out. Ways are ours by `method[:degree[:option=value,...]]` and those of the RTI tools by the names of their bases.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.pages import check_markdown, replace_block
from benchmarks.rti_page import StackResult, draw_pictures, markdown_table, quality_table, size_table, stack_table
from benchmarks.rti_stacks import Case, crop, find_stacks, read_case
from benchmarks.rti_ways import Found, Way, default_ways, measure_way, photograph
from clrelight.cli.output import print_facts
from clrelight.cli.tables import print_table
from clrelight.conventions import TRANSFERS
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.speed.environment import describe_environment

BEGIN, END = "<!-- rti -->", "<!-- /rti -->"
QUICK_PIXELS, _WARM_PIXELS = 64, 16


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--stacks", "patterns", multiple=True, metavar="GLOB", help="Such as 'Single/*' or Real/item5; repeatable."
)
@click.option(
    "--way", "texts", multiple=True, help="Instead of the usual ones, such as spline:15:lam=1e-3; repeatable."
)
@click.option("--code", "coded", multiple=True, help="Fits that go through klt too (default: the first way).")
@click.option("--transfer", type=click.Choice(TRANSFERS), default="linear", show_default=True, help="What codes mean.")
@click.option("--quick", is_flag=True, help=f"The middle {QUICK_PIXELS} pixels only: shows that it works.")
@click.option("--device", "device_name", help="Index, gpu, cpu, pocl or a part of a name.")
@click.option("--json", "json_path", type=click.Path(dir_okay=False, path_type=Path), help="Keep all figures.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help=f"Fill what stands between {BEGIN}s.")
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), help="Draw stacks into this folder.")
def main(
    patterns: tuple[str, ...],
    texts: tuple[str, ...],
    coded: tuple[str, ...],
    transfer: str,
    quick: bool,
    device_name: str | None,
    json_path: Path | None,
    markdown: Path | None,
    pictures: Path | None,
) -> None:
    """Measure all ways on all stacks: PSNR, SSIM, bytes and seconds."""
    try:
        ways = [Way(text) for text in dict.fromkeys(texts or default_ways())]
        small = set(coded or (ways[0].text,))
        for way in ways:
            _ = way.label
        if not small <= {way.text for way in ways}:
            raise InputError(f"--code names ways that are measured: {', '.join(way.text for way in ways)}")
        sources = find_stacks(patterns)
        if markdown is not None:
            check_markdown(markdown, BEGIN, END)
        device = open_device(device_name)
    except InputError as error:
        raise click.UsageError(str(error)) from None
    results: list[StackResult] = []
    for source in sources:
        try:
            case = read_case(source, transfer, QUICK_PIXELS if quick else None)
        except InputError as error:
            click.echo(f"{source.name} is left out: {error}", err=True)
            continue
        if not results:
            _warm_up(case, ways, device)
        results.append(_measure(case, ways, small, device))
        facts = {**describe_environment(device), "work": _describe(results, transfer, quick)}
        if json_path is not None:
            json_path.write_text(json.dumps(_to_json(results, facts), indent=1) + "\n", encoding="utf-8")
    if not results:
        raise click.ClickException("no stack could be read")
    tables = [make(results, ways) for make in (quality_table, size_table, stack_table)]
    for headers, rows in tables:
        click.echo()
        print_table(headers, rows)
    click.echo()
    print_facts(facts)
    drawn: dict[Path, str] = {}
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        drawn = draw_pictures(pictures, results, ways)
        for path, caption in drawn.items():
            click.echo(f"{path}: {caption}")
    if markdown is not None:
        lines = [f"- {name}: {facts[name]}" for name in ("measured", "commit", "machine", "device", "work")]
        parts = ["\n".join(lines), *(markdown_table(*table) for table in tables)]
        for path, caption in drawn.items():
            parts.append(f"![{caption}]({Path(os.path.relpath(path, markdown.parent)).as_posix()})\n\n{caption}")
        replace_block(markdown, "\n\n".join(parts), BEGIN, END)


def _warm_up(case: Case, ways: list[Way], device: Device) -> None:
    """Build the kernels, which seconds are not to hold."""
    few = replace(case, stack=crop(case.stack, _WARM_PIXELS))
    for way in ways:
        measure_way(way, few, device, coded=False)


def _measure(case: Case, ways: list[Way], coded: set[str], device: Device) -> StackResult:
    found = {}
    for way in ways:
        found[way] = measure_way(way, case, device, coded=not way.is_fit or way.text in coded)
        click.echo(f"{case.source.name:26} {way.label:28} {_line(found[way])}")
    light, mask_hw = case.example_light, case.mask_hw
    pixels = int(np.count_nonzero(mask_hw))
    return StackResult(case.source.name, case.source.group, pixels, photograph(case, light), mask_hw, found)


def _line(found: Found) -> str:
    if found.score is None:
        return found.what
    score = found.score
    return f"{score.psnr_mean:6.2f} {score.psnr_pooled:6.2f} dB  {score.ssim:.3f}  {found.seconds:6.2f} s  {found.what}"


def _describe(results: list[StackResult], transfer: str, quick: bool) -> str:
    part = f", the middle {QUICK_PIXELS} pixels only" if quick else ""
    return f"{len(results)} stacks, code values taken as {transfer}{part}; figures are PSNR mean / pooled / SSIM"


def _to_json(results: list[StackResult], facts: dict[str, str]) -> dict[str, Any]:
    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: plain(entry) for name, entry in value.items()}
        if isinstance(value, list | tuple):
            return [plain(entry) for entry in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    rows = [
        {"stack": r.name, "group": r.group, "pixels": r.pixels, "way": way.text, **asdict(replace(found, example=None))}
        for r in results
        for way, found in r.found.items()
    ]
    return {"environment": facts, "rows": plain(rows)}


if __name__ == "__main__":
    main()
