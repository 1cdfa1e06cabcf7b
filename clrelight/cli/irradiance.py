"""``clrelight irradiance``."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.maps import MapReading, map_options
from clrelight.cli.options import device_option, json_option, whole_number
from clrelight.cli.output import print_report
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from clrelight.device import Device
    from clrelight.jobs.report import Report
    from clrelight.lighting.environment import Environment

_DEGREE = 2
"""Of the light whose nine coefficients give irradiance."""


@click.command()
@click.argument("environments", metavar="FILE...", type=click.Path(), nargs=-1, required=True)
@click.argument("out", type=click.Path())
@map_options
@click.option(
    "--method",
    type=click.Choice(["nine", "brute"]),
    default="nine",
    show_default=True,
    help="From nine coefficients, or by summing the whole map for every normal.",
)
@click.option("--size", type=whole_number(1, 4096), default=64, show_default=True, help="Rows of the irradiance map.")
@click.option(
    "--map",
    "shape",
    type=click.Choice(["latlong", "angular"]),
    default="latlong",
    show_default=True,
    help="Layout of the irradiance map.",
)
@device_option
@json_option
def irradiance(
    environments: tuple[str, ...],
    out: str,
    reading: MapReading,
    method: str,
    size: int,
    shape: str,
    device: str | None,
    as_json: bool,
) -> None:
    """Write the irradiance that matte surfaces receive, as a map over their normals.

    The map has the view of the environment's own and holds floats (.exr, .hdr, .tif). With --json, the matrix M of each
    channel for a shader is printed too: E(n) = (n, 1) M (n, 1).

    \b
    Example:
      clrelight irradiance grace_probe.hdr irradiance.exr
      clrelight irradiance grace_probe.hdr exact.exr --method brute --map angular --size 256
    """
    import numpy as np

    from clrelight.device import open_device
    from clrelight.images import write_image
    from clrelight.jobs.pictures import FLOAT_FORMATS, holds_floats
    from clrelight.jobs.report import Report
    from clrelight.lighting import layouts
    from clrelight.lighting.irradiance import compare_irradiance, evaluate_irradiance, irradiance_matrix
    from clrelight.lighting.projection import project_environment

    if not holds_floats(out):
        raise InputError(f"irradiance is linear radiance: write it to {', '.join(FLOAT_FORMATS)}, got {out}")
    claim_output(out, environments)
    report = Report()
    environment, opened = reading.read(environments, report), open_device(device)
    report.device = opened.info.label
    since = time.perf_counter()
    light = project_environment(environment, _DEGREE, device=opened)
    report.add("project", since)
    width = 2 * size if shape == "latlong" else size
    view_n3, weights_n = layouts.texel_geometry(shape, size, width)
    normals_n3 = view_n3 @ layouts.parse_axes(reading.axes)[1].T
    since = time.perf_counter()
    values_nc = evaluate_irradiance(light, normals_n3).astype(np.float32)
    report.add("nine", since)
    facts: dict[str, Any] = {"file": out, "method": method, "matrix": irradiance_matrix(light)}
    if method == "brute":
        exact_nc = _integrate(environment, normals_n3, opened, report)
        error = compare_irradiance(values_nc, exact_nc, weights_n, light)
        facts.update({"nine_error_mean": error.mean, "nine_error_maximum": error.maximum})
        values_nc = exact_nc
    values_nc = np.where(weights_n[:, None] > 0, values_nc, np.float32(0.0))  # corners of an angular map
    since = time.perf_counter()
    write_image(out, values_nc.reshape(size, width, light.channels))
    report.add("write", since)
    report.facts = {**facts, "coefficients": light.coeffs_kc}
    lines = {"irradiance": out, "map": f"{shape}, {width}×{size}", "method": method}
    if method == "brute":
        mean, most = facts["nine_error_mean"], facts["nine_error_maximum"]
        lines["nine are off"] = f"{mean:.2%} of the light on average, {most:.2%} at most"
    print_report(report, as_json, lines)


def _integrate(
    environment: Environment, normals_n3: NDArray[np.float64], device: Device, report: Report
) -> NDArray[np.float32]:
    from clrelight.lighting.irradiance import integrate_irradiance

    since = time.perf_counter()
    with progress_bar("integrating") as bar:
        exact_nc = integrate_irradiance(environment, normals_n3, device=device, progress=bar)
    report.add("brute", since)
    return exact_nc


COMMANDS = (irradiance,)
