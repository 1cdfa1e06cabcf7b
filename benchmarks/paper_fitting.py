"""The experiments of noise-resistant-fitting beside its PSNRs, in full: ``python -m benchmarks.paper_fitting``.

Deletion of basis functions, what a hemisphere does not see, figure 11, VQ and CPCA, and table II as slopes.
Ends with exit code 1 where something that the paper says does not hold.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import click

from clrelight.device import open_device
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
def main(only: tuple[str, ...], rounds: int) -> None:
    """Run the parts; exit code 1 where a verdict is no."""
    names = only or tuple(PARTS)
    kept = True
    for name in names:
        part = PARTS[name](rounds)
        kept &= all(part.verdicts.values())
        said = [[what, "yes" if holds else "no"] for what, holds in part.verdicts.items()]
        block = part.text if name == "table-2" else f"{part.text}\n\n{table(['what must hold', 'does'], said)}"
        click.echo(block + "\n")
    sys.exit(0 if kept else 1)


if __name__ == "__main__":
    main()
