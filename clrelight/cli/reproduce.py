"""``clrelight reproduce``."""

from __future__ import annotations

from pathlib import Path

import click

from clrelight.cli.options import device_option, json_option
from clrelight.cli.output import print_facts, print_json
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table

_WIDEST = 62
"""Characters of a cell on a terminal."""


@click.command()
@click.argument("paper", required=False)
@click.argument("items", metavar="[FIGURE|TABLE]...", nargs=-1)
@click.option(
    "--data",
    type=click.Path(file_okay=False, path_type=Path),
    envvar="CLRELIGHT_DATA",
    metavar="FOLDER",
    help="Folder of probes, meshes and brdf; default: $CLRELIGHT_DATA. Rows whose file it lacks are not computed.",
)
@click.option("--quick", is_flag=True, help="Only what takes seconds.")
@click.option("--list", "lists", is_flag=True, help="Say which papers, figures and tables there are, and end.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE", help="Write the page too.")
@click.option(
    "--pictures",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Write the figures into it.",
)
@device_option
@json_option
@click.pass_context
def reproduce(
    context: click.Context,
    paper: str | None,
    items: tuple[str, ...],
    data: Path | None,
    quick: bool,
    lists: bool,
    markdown: Path | None,
    pictures: Path | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Compute what the papers print, beside the printed, with a verdict; exit code 1 if one fails.

    PAPER is fitting, irradiance, gritty, frequency or variation; default: all. A number means a figure.

    \b
    Example:
      clrelight reproduce --data data/ --markdown reproduction.md --pictures images/
      clrelight reproduce fitting "table III"
      clrelight reproduce variation 7 9
    """
    from clrelight.reproduction.page import write_page, write_pictures
    from clrelight.reproduction.registry import choose
    from clrelight.reproduction.run import reproduce as compute

    chosen = choose(paper, items, quick=quick)
    if lists:
        if as_json:
            print_json({each.id: each.items() for each in chosen})
        else:
            print_facts({each.id: each.items() for each in chosen})
        return
    _check_folders(markdown, pictures)
    with progress_bar("reproduce") as bar:
        made = compute(chosen, data=data, device=device, draws=pictures is not None, progress=lambda *step: bar(*step))
    if pictures is not None:
        write_pictures(pictures, made)
    if markdown is not None:
        write_page(markdown, made, chosen, pictures)
    if as_json:
        told = {"rows": [each.to_json() for each in made.outcomes], "verdicts": made.counts()}
        print_json({**told, "seconds": made.seconds, "pictures": list(made.pictures) if pictures else []})
    else:
        rows = [
            [each.paper, each.item, *map(_cut, (each.what, each.printed, each.ours, each.tolerance)), each.verdict,
             _cut(each.reason)]
            for each in made.outcomes
        ]  # fmt: skip
        headers = ["paper", "item", "what", "printed", "ours", "tolerance", "verdict", "why"]
        print_table(headers, rows, ("why", "tolerance"))
        print_facts({"papers": len(chosen), **made.counts(), "seconds": sum(made.seconds.values())})
    if not made.holds:
        context.exit(1)


def _check_folders(markdown: Path | None, pictures: Path | None) -> None:
    """Raise InputError where what is to be written has no place, before long work."""
    from clrelight.errors import InputError

    if markdown is not None and not markdown.parent.is_dir():
        raise InputError(f"there is no folder {markdown.parent} for {markdown.name}")
    if pictures is not None and not pictures.parent.is_dir():
        raise InputError(f"there is no folder {pictures.parent} for {pictures.name}")


def _cut(text: str) -> str:
    return text if len(text) <= _WIDEST else text[: _WIDEST - 1] + "…"


COMMANDS = (reproduce,)
