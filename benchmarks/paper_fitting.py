"""The experiments of noise-resistant-fitting that no other page has, with what the paper prints beside.

    python -m benchmarks.paper_fitting --markdown docs/experiments.md --pictures docs/images

Deletion of basis functions, what a hemisphere does not see, figure 11, VQ and CPCA, and table II as slopes.
Ends with exit code 1 where something that the paper says does not hold.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import click

from benchmarks.pages import check_markdown, replace_block
from clrelight.device import open_device
from clrelight.report.canvas import save
from clrelight.reproduction.complexity import table_two
from clrelight.reproduction.deletion import deletion
from clrelight.reproduction.eigenvectors import eigenvectors, figure_11
from clrelight.reproduction.parts import Part, table
from clrelight.reproduction.vector_codecs import vector_codecs

PARTS: dict[str, Callable[[int], Part]] = {
    "deletion": lambda rounds: deletion(),
    "eigenvectors": lambda rounds: eigenvectors(),
    "figure-11": lambda rounds: figure_11(),
    "codecs": lambda rounds: vector_codecs(open_device()),
    "table-2": lambda rounds: table_two(open_device(), rounds),
}


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--only", multiple=True, type=click.Choice(list(PARTS)), help="Parts to run; default: all.")
@click.option("--rounds", type=int, default=7, show_default=True, help="Interleaved rounds of timing (table-2).")
@click.option("--markdown", type=click.Path(path_type=Path), metavar="FILE", help="Page whose blocks are replaced.")
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), metavar="DIR", help="Where pictures go.")
def main(only: tuple[str, ...], rounds: int, markdown: Path | None, pictures: Path | None) -> None:
    """Run the parts; exit code 1 where a verdict is no."""
    names = only or tuple(PARTS)
    if markdown is not None:
        for name in names:
            check_markdown(markdown, *_marks(name))
    kept = True
    for name in names:
        part = PARTS[name](rounds)
        kept &= all(part.verdicts.values())
        said = [[what, "yes" if holds else "no"] for what, holds in part.verdicts.items()]
        block = part.text if name == "table-2" else f"{part.text}\n\n{table(['what must hold', 'does'], said)}"
        click.echo(block + "\n")
        if markdown is not None:
            replace_block(markdown, block, *_marks(name))
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            for file, figure in part.figures.items():
                save(figure, pictures / file)
    sys.exit(0 if kept else 1)


def _marks(name: str) -> tuple[str, str]:
    return f"<!-- paper {name} -->", f"<!-- /paper {name} -->"


if __name__ == "__main__":
    main()
