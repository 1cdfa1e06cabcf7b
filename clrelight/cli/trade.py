"""``clrelight trade``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import (
    ByteCount,
    Names,
    Numbers,
    device_option,
    given,
    holdout_by_option,
    json_option,
    whole_number,
)
from clrelight.cli.output import decibel, print_facts, print_json, print_notes
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.experiment.axes import Axes
    from clrelight.experiment.grid import CodecSetting
    from clrelight.experiment.pareto import Limits, Trial

_MARK = "# The setting that clrelight trade chose:"


@click.command()
@click.argument("stack", metavar="STACK.h5", type=click.Path())
@click.option("--out", type=click.Path(), default="trade.h5", show_default=True, help="Results file.")
@click.option("--report", "report_to", type=click.Path(), metavar="DIR", help="Folder for tables, CSV and chart.")
@click.option("--budget-seconds", type=float, help="At most so long for fitting, encoding and decoding.")
@click.option("--budget-bytes", type=ByteCount(), metavar="BYTES", help="At most so large.")
@click.option("--min-psnr", type=float, metavar="DB", help="At least this pooled PSNR at held-out lights.")
@click.option(
    "--config", type=click.Path(), metavar="FILE.toml", help="Where the setting to use is written; default: OUT.toml."
)
@click.option("--methods", type=Names(), help="Fits; default: those of auto.")
@click.option("--degrees", type=Numbers(int, "4,6,8"), help="SH degrees, tried upwards; default: auto's, 0 to 25.")
@click.option("--iterations", type=Numbers(int, "8,32"), help="Bisection steps of cls; default 4,8,16,32.")
@click.option("--newton-steps", type=Numbers(int, "1,2"), help="Newton steps of cls; default 1,2,4,8.")
@click.option("--precisions", type=Names(), help="Precisions beside mixed; default single,double where they differ.")
@click.option("--lights", type=Numbers(int, "24,48"), help="Fewer lights to fit; default a half and a quarter.")
@click.option("--codecs", type=Names(), help="Codecs beside float32; default half,klt,wavelet,s3tc.")
@click.option("--rates", type=Numbers(float, "0.1,1"), help="Bits per coefficient; default 1,0.5,0.25,0.1.")
@click.option("--holdout", type=whole_number(2), metavar="K", default=5, show_default=True,
              help="Every K-th light is in no fit, and measures all.")  # fmt: skip
@holdout_by_option
@click.option(
    "--megapixels",
    type=float,
    default=0.1,
    show_default=True,
    help="Measure larger images in windows of so many together, and reckon for the whole; inf: measure all.",
)
@click.option("--force", is_flag=True, help="Start anew although the results file exists.")
@device_option
@json_option
def trade(
    stack: str,
    out: str,
    report_to: str | None,
    budget_seconds: float | None,
    budget_bytes: int | None,
    min_psnr: float | None,
    config: str | None,
    force: bool,
    device: str | None,
    as_json: bool,
    **axes: Any,
) -> None:
    """Measure what each choice costs in quality, time and bytes, and answer a budget.

    Varied are method, degree, the search of cls, the number of lights, precision, codec and rate; what is beaten
    clearly is not varied further. The same command goes on where it stopped. The setting to use is printed, and written
    for fit --config and for bench: the smallest that is at most 0.3 dB below the best, or with a budget or a least PSNR
    the best within them; where nothing measured is, the nearest is named (exit code 2; the results stay).

    \b
    Example:
      clrelight trade stack.h5 --report trade
      clrelight trade stack.h5 --budget-bytes 50k --budget-seconds 2
    """
    from clrelight.device import open_device
    from clrelight.experiment.axes import Axes
    from clrelight.experiment.pareto import Limits
    from clrelight.experiment.trade import sweep_trade
    from clrelight.holdout import describe_distance
    from clrelight.report.folder import check_report
    from clrelight.report.trade import about_excerpt
    from clrelight.store import check_output, open_stack

    limits = Limits(budget_seconds, budget_bytes, min_psnr)
    varied = Axes(**given(**axes))
    target = Path(config or Path(out).with_suffix(".toml"))
    check_output(out, [stack])
    check_output(target, [stack, out])
    if config is None and target.exists() and not target.read_bytes().startswith(_MARK.encode()):
        raise InputError(f"{target} is there and was not written by trade: name another file with --config")
    check_report(report_to)
    with open_stack(stack) as source, progress_bar("trade") as bar:
        name, notes = source.name, list(source.notes)
        trials = sweep_trade(
            source,
            stack,
            out,
            varied,
            device=open_device(device),
            force=force,
            progress=lambda step, done, total: bar(done, total, step),
            tell=notes.append,
        )
        distance = describe_distance(source.directions_i3, *varied.split(source.directions_i3))
    chosen, paths = _choose(limits, trials, name, report_to)
    facts: dict[str, Any] = {"results": out, "rows": len(trials), "held_out": distance, "notes": notes}
    if trials[0].scale > 1.0:
        facts["measured"] = about_excerpt(trials)
    if paths:
        facts["report"] = str(paths[0])
    facts |= _write_choice(chosen, stack, varied, target)
    if as_json:
        facts["trials"] = [_facts(trial) for trial in trials]
        print_json({**facts, "choice": _facts(chosen)})
        return
    print_notes(facts.pop("notes"))
    facts["unseen"] = facts.pop("held_out")
    _print_tables(trials, chosen)
    facts["it reaches"] = f"{decibel(chosen.psnr)} held out, {chosen.size} bytes, {chosen.seconds:.3g} s"
    print_facts(facts | _commands(stack, target, chosen.setting))


def _choose(limits: Limits, trials: Sequence[Trial], name: str, report_to: str | None) -> tuple[Trial, list[Path]]:
    """Return what to take, and the report's files, which are written where there is nothing to take too."""
    from clrelight.report.trade import write_trade_report

    chosen = None
    try:
        chosen = limits.choose(trials)
    finally:
        paths = [] if report_to is None else write_trade_report(trials, name, report_to, chosen)
    return chosen, paths


def _print_tables(trials: Sequence[Trial], chosen: Trial) -> None:
    from clrelight.report.markup import to_strings
    from clrelight.report.trade import front_table, step_table

    for table in (step_table(trials), front_table(trials, chosen)):
        click.echo(f"{table.caption}:")
        print_table(*to_strings(table))
        click.echo("")


def _write_choice(chosen: Trial, stack: str, varied: Axes, target: Path) -> dict[str, str]:
    """Write the experiment that makes what was chosen, for fit and bench; return what to tell of it."""
    from clrelight.durable import replacing
    from clrelight.experiment.toml import experiment_text

    about = f"{_MARK[2:]}\n{_summary(chosen)}"
    text = experiment_text(chosen.to_experiment(stack, varied.holdout, varied.holdout_by), target.parent, about)
    with replacing(target) as part:
        part.write(text.encode("utf-8"))
    return {"choice": chosen.label, "config": str(target)}


def _commands(stack: str, config: Path, setting: CodecSetting) -> dict[str, str]:
    """Return the commands that make what was chosen."""
    fit = f"clrelight fit {stack} fit.h5 --config {config}"
    if setting.codec is None:
        return {"next": fit}
    rate = "" if math.isnan(setting.rate) else f" --rate {setting.rate:g}"
    then = f"clrelight encode fit.h5 small.h5 --codec {setting.id}{rate}"
    # The same coefficients; the fit keeps its map of lambda or rank beside them.
    return {"next": fit, "then": then, **({"or at once": f"{fit} --store float16"} if setting.id == "half" else {})}


def _summary(chosen: Trial) -> str:
    return (
        f"{chosen.label}\n{chosen.psnr:.2f} dB pooled at held-out lights, {chosen.size} bytes, "
        f"{chosen.seconds:.3g} s to fit, encode and decode"
    )


def _facts(trial: Trial) -> dict[str, Any]:
    names = trial.row.dtype.names or ()
    whole = {"seconds": trial.seconds, "bytes": trial.size}
    return {"label": trial.label, **{name: trial.row[name] for name in names}, **whole}


COMMANDS = (trade,)
