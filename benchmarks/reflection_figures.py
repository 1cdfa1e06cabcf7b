"""Figures 1, 5, 7, 8, 9 and 10 of frequency-space-environment-maps, and what pictures tell of materials.

``python -m benchmarks.reflection_figures --pictures docs/images --markdown docs/shrm.md`` draws them with their RMS
errors beside integration over all angles, and renews the page's blocks; ``--only 7`` one of them. Probes, meshes and
paints are those of ``CLRELIGHT_DATA``.
"""

from __future__ import annotations

import os
from pathlib import Path

import click

from benchmarks.pages import replace_block
from benchmarks.reflection import to_table
from clrelight.reproduction.reflection_figures import FIGURES, chart_8, draw


@click.command()
@click.option("--pictures", type=click.Path(file_okay=False, path_type=Path), help="Folder of shrm_figure*.jpg.")
@click.option("--markdown", type=click.Path(path_type=Path), help="Page whose blocks are renewed.")
@click.option("--only", multiple=True, help="A figure's number, storage, codecs or materials; several times.")
def main(pictures: Path | None, markdown: Path | None, only: tuple[str, ...]) -> None:
    """Draw figures and renew the tables below them."""
    from benchmarks.reflection_materials import TABLES

    data = Path(os.environ.get("CLRELIGHT_DATA") or "../shared/data")
    if not (data / "probes").is_dir():
        raise click.UsageError(f"there is no {data / 'probes'}: CLRELIGHT_DATA must name the folder of probes")
    known = [*FIGURES, *TABLES]
    if unknown := [name for name in only if name not in known]:
        raise click.UsageError(f"figures and tables are {', '.join(known)}, got {unknown[0]}")
    for name in only or known:
        if name in FIGURES:
            panels, table = FIGURES[name](data)
            if pictures is not None and panels:
                draw(pictures / f"shrm_figure{name}.jpg", panels)
            elif pictures is not None:
                chart_8(pictures / f"shrm_figure{name}.png", table)
            block, marker = to_table(*table), f"figure {name}"
        else:
            block, marker = to_table(*TABLES[name](data)), name
        click.echo(f"{marker}\n{block}\n")
        if markdown is not None:
            replace_block(markdown, block, f"<!-- {marker} -->", f"<!-- /{marker} -->")


if __name__ == "__main__":
    main()
