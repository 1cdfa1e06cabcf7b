"""What `auto` reaches with few lights of domes that are known: ``python -m benchmarks.auto_domes``.

Columns of three kinds under 4 to 49 lights in 8 bits, tested under 163 others: a cubic of the light's direction,
Lambert's cosine with shadows attached, and that with gloss. Beside it is the best of a grid of methods and degrees,
which nobody could know beforehand.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.fit import PreparedFit, collect_fit, prepare_fit
from clrelight.harmonics.basis import evaluate_basis
from clrelight.metrics import measure_errors
from clrelight.sampling import make_pattern

COUNTS = (4, 6, 9, 12, 16, 25, 36, 49)
COLUMNS = 600
GRID = [("uls", range(8)), ("cls", (0, 1, 2, 3, 4, 6, 9)), ("spline", (2, 3, 4, 6, 9, 15))]
SPLINES = (3e-4, 1e-3)


def list_scenes(lights: NDArray, tests: NDArray) -> Iterator[tuple[str, NDArray, NDArray]]:
    """Yield name, and values under the lights and under those that test them."""
    rng = np.random.default_rng(3)
    cubic_kp = rng.standard_normal((16, COLUMNS)) * np.repeat([0.0, 0.3, 0.15, 0.08], [1, 3, 5, 7])[:, None]
    seen, held = (evaluate_basis(directions, 3) @ cubic_kp for directions in (lights, tests))
    least, most = min(seen.min(), held.min()), max(seen.max(), held.max())
    yield ("cubic", *((values - least) / (most - least) for values in (seen, held)))
    normals = rng.standard_normal((3, COLUMNS)) * [[0.6], [0.6], [0.3]] + [[0.0], [0.0], [1.0]]
    normals /= np.linalg.norm(normals, axis=0)
    albedo_p = rng.uniform(0.3, 1.0, COLUMNS)
    cosines = [np.maximum(directions @ normals, 0.0) for directions in (lights, tests)]
    yield ("Lambert", *(albedo_p * cosine for cosine in cosines))
    yield ("gloss", *(albedo_p * (0.2 + 0.4 * cosine) + 0.4 * cosine**8 for cosine in cosines))


def make_stack(value_ip: NDArray, directions_i3: NDArray) -> LightStack:
    """Return columns in 8 bits."""
    codes = np.rint(255.0 * np.clip(value_ip, 0.0, 1.0)).astype(np.uint8)
    return LightStack(codes.reshape(len(directions_i3), 1, -1, 3), directions_i3, 255.0)


def mean_psnr(prepared: PreparedFit, tested: LightStack) -> float:
    """Return the mean PSNR in dB over the lights that test a fit."""
    errors_i = measure_errors(collect_fit(prepared), tested, device=prepared.device)
    return float(np.mean(-10.0 * np.log10(np.maximum(errors_i, 1e-13))))


def best_of_grid(seen: LightStack, tested: LightStack, device: Device) -> tuple[float, str]:
    """Return the best PSNR of the grid, and whose it is."""
    asked = [(method, degree, {}) for method, degrees in GRID for degree in degrees]
    asked += [("spline", 15, {"lam": lam}) for lam in SPLINES]
    reached = []
    for method, degree, options in asked:
        try:
            prepared = prepare_fit(seen, method, degree, options=options, device=device)
        except InputError:  # fewer lights than coefficients
            continue
        reached.append(
            (mean_psnr(prepared, tested), f"{method} {degree}" + "".join(f", λ {v:g}" for v in options.values()))
        )
    return max(reached)


def main() -> None:
    """Print a row of a Markdown table for each scene and count."""
    warnings.simplefilter("ignore")
    device, tests = open_device(None), make_pattern("uniform", 163)
    print("| scene | lights | `auto` took | PSNR | best of the grid | PSNR |\n" + "|---" * 6 + "|")
    for count in COUNTS:
        lights = make_pattern("uniform", count)
        for name, seen_ip, held_ip in list_scenes(lights, tests):
            seen, tested = make_stack(seen_ip, lights), make_stack(held_ip, tests)
            prepared = prepare_fit(seen, "auto", "auto", device=device)
            best, whose = best_of_grid(seen, tested, device)
            took = f"{prepared.method.id} {prepared.degree}"
            print(
                f"| {name} | {count} | {took} | {mean_psnr(prepared, tested):.2f} | {whose} | {best:.2f} |", flush=True
            )


if __name__ == "__main__":
    main()
