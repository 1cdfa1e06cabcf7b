"""Draw figures of two papers with surfaces: ``python -m benchmarks.surface_figures --out DIR``.

Figures 1 and 4 of irradiance-environment-maps; of spherical-harmonic-lighting 6 to 11 and 13 to 15, its skies and caps.
The probe and the armadillo are those of ``$CLRELIGHT_DATA`` (default ../shared/data); figures that need one are left
out where it is not there. docs/rendering.md shows them.
"""

from __future__ import annotations

import os
from pathlib import Path

import click

from clrelight.images import write_image
from clrelight.lighting.environment import read_environment
from clrelight.reproduction.surface_figures import basis, lights, objects, products, projections, transfers
from clrelight.transfer.mesh_files import read_mesh

DATA = Path(os.environ.get("CLRELIGHT_DATA", "../shared/data"))


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True, help="Folder of the pictures.")
@click.option("--samples", type=int, default=1024, show_default=True, help="Rays of a vertex.")
@click.option("--scale", type=float, default=1.0, show_default=True, help="Of the pictures' sides.")
def main(out: Path, samples: int, scale: float) -> None:
    """Write the pictures, and print how many bytes they take."""
    out.mkdir(parents=True, exist_ok=True)
    size = lambda side: max(8, round(scale * side))  # noqa: E731
    pictures = {
        "functions": projections(size(96)),
        "product": products(size(128)),
        **transfers(size(210), samples),
        "lights": lights(size(112), samples),
    }
    if (DATA / "meshes" / "armadillo.ply").is_file() and (DATA / "probes" / "grace_cross.hdr").is_file():
        armadillo = read_mesh(DATA / "meshes" / "armadillo.ply", up="y")
        grace, _ = read_environment(DATA / "probes" / "grace_cross.hdr")
        pictures["objects"] = objects(armadillo, grace, size(480))
        pictures["basis"] = basis(armadillo, size(60))
    else:
        click.echo(f"note: no armadillo or no probe under {DATA}: figures 1 and 4 are left out")
    total = 0
    for name, picture in pictures.items():
        path = out / f"surface_{name}.jpg"
        write_image(path, picture)
        total += path.stat().st_size
        click.echo(f"{path}  {picture.shape[1]}×{picture.shape[0]}  {path.stat().st_size} bytes")
    click.echo(f"{total} bytes")


if __name__ == "__main__":
    main()
