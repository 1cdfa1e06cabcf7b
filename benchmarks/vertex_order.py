"""Sizes of diffuse transfer by the order of its vertices: ``python -m benchmarks.vertex_order [MESH]``.

The error is that of the transfer functions over all directions: the signal-to-noise ratio of their coefficients.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

import clrelight as cr
from benchmarks.lighting import Table, show_parts
from clrelight.dataset import CoefficientMap
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.surface import Surface
from clrelight.transfer.brdfs import Diffuse
from clrelight.transfer.lobes import frames_of
from clrelight.transfer.mesh_files import read_mesh
from clrelight.transfer.operators import transfer_operators
from clrelight.transfer.vertex_order import IMAGES, ORDERS, VertexOrder, fold_surface, reorder, reorder_map

TARGET = 25.0
"""Decibels at which codecs with a rate are compared."""
RATES = {"wavelet": ("rate", (0.5, 1.0, 2.0, 4.0, 6.0)), "klt": ("step", (0.2, 0.05, 0.0125, 0.003, 0.0008))}
FIXED = {"s3tc": {}, "uniform": {"bits": 6}}


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("mesh", required=False, type=click.Path(path_type=Path))
@click.option("--samples", type=click.IntRange(min=16), default=1024, show_default=True, help="Rays of each vertex.")
@click.option("--picture", type=click.Path(dir_okay=False), metavar="FILE.png", help="Draw normals in three images.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the table of a page.")
def main(mesh: Path | None, samples: int, picture: str | None, markdown: Path | None) -> None:
    """Encode diffuse, shadowed transfer of degree 4 in every order, and print bytes and errors."""
    if mesh is None and "CLRELIGHT_DATA" not in os.environ:
        raise InputError("give a mesh, or set CLRELIGHT_DATA: its meshes/armadillo.ply is taken")
    surface = read_mesh(mesh or Path(os.environ["CLRELIGHT_DATA"]) / "meshes" / "armadillo.ply")
    if picture is not None:
        draw(surface, picture)
        return
    local = replace(surface, tangents_v3=frames_of(surface.normals_v3)[:, 0])
    maps = diffuse_map(replace(surface, tangents_v3=None), samples, "global"), diffuse_map(local, samples, "local")
    show_parts({"orders": order_table(*maps, open_device(None))}, markdown)


def draw(surface: Surface, picture: str) -> None:
    """Write the normals, as colours, of images in three orders side by side."""
    images = []
    for order in ("file", "hilbert", "sorted"):
        folded = fold_surface(surface, order)[0]
        shown_hwc = (127.5 + 127.5 * folded.normals_v3.reshape(*folded.map_shape, 3)).round().astype(np.uint8)
        images.append(
            np.pad(shown_hwc.repeat(2, axis=0).repeat(2, axis=1), ((0, 0), (0, 8), (0, 0)), constant_values=255)
        )
    write_image(picture, np.concatenate(images, axis=1)[:, :-8])


def diffuse_map(surface: Surface, samples: int, light_frame: str) -> CoefficientMap:
    """Return the transfer vectors: operators whose views are constants."""
    made = transfer_operators(surface, Diffuse(), 4, view_degree=0, samples=samples, light_frame=light_frame)
    return replace(
        made, coeffs_khwc=np.asarray(made.coeffs_khwc) * np.float32(np.sqrt(0.25 / np.pi)), method="transfer"
    )


def order_table(common: CoefficientMap, local: CoefficientMap, device: Device) -> Table:
    """Return a row for each order, as a list and as an image."""
    rows = []
    for order in ORDERS:
        forms = ["image"] if order in IMAGES else ["list", "image"]
        for form in forms:
            since = time.process_time()
            surface, places = reorder(common.surface, order) if form == "list" else fold_surface(common.surface, order)
            seconds = time.process_time() - since
            own = fold_surface(local.surface, order)[0] if form == "image" else reorder(local.surface, order)[0]
            moved, moved_local = reorder_map(common, surface, places), reorder_map(local, own, places)
            row = [f"{order}, {form}", f"{seconds:.1f}"]
            row.append(kilobytes(searched(moved, common, places, "wavelet", device)))
            row.append(kilobytes(searched(moved_local, local, places, "klt", device)))
            for codec, options in FIXED.items():
                ratio, size = coded(moved, common, places, codec, options, device)
                row.append(f"{kilobytes(size)}, {ratio:.1f} dB")
            rows.append(row)
    at = f"kB at {TARGET:g} dB"
    return ["order", "s", f"wavelet, {at}", f"klt in local frames, {at}", "s3tc, kB", "uniform, 6 bit, kB"], rows


def searched(moved: CoefficientMap, before: CoefficientMap, places: VertexOrder, codec: str, device: Device) -> float:
    """Return bytes at the target, between the sizes at some rates; NaN beyond them."""
    option, values = RATES[codec]
    points = sorted(coded(moved, before, places, codec, {option: value}, device) for value in values)
    ratios, sizes = zip(*points, strict=True)
    return float(np.exp(np.interp(TARGET, ratios, np.log(sizes), np.nan, np.nan)))


def coded(
    moved: CoefficientMap, before: CoefficientMap, places: VertexOrder, codec: str, options: dict, device: Device
) -> tuple[float, float]:
    """Return the signal-to-noise ratio in decibels of what decodes, and bytes."""
    encoded = cr.encode(moved, codec, device=device, **options)
    decoded = cr.decode(encoded, device=device).coeffs_khwc.reshape(moved.n_coeff, -1)
    exact = before.coeffs_khwc.reshape(before.n_coeff, -1)
    error = places.undo(decoded, 1) - exact
    if moved.config.get("light_frame") == "local":  # functions of what lies above the horizon
        from clrelight.harmonics.hemisphere import hemisphere_autocorrelation

        metric = hemisphere_autocorrelation(before.degree)
        signal, noise = (float(np.einsum("kp,kl,lp->", v, metric, v, optimize=True)) for v in (exact, error))
    else:
        signal, noise = float((exact**2).sum()), float((error**2).sum())
    return 10.0 * np.log10(signal / noise), float(encoded.encoded_bytes)


def kilobytes(size: float) -> str:
    return "–" if np.isnan(size) else f"{size / 1000:.0f}"


if __name__ == "__main__":
    main()
