"""What reflection maps cost beside integration over angles (frequency-space-environment-maps, tables 3 to 5)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from clrelight.brdf.analytic import Microfacet
from clrelight.brdf.coefficients import BrdfCoefficients, brdf_coefficients
from clrelight.brdf.radial import Phong
from clrelight.device import Device
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.latlong import latitude_weights, project_latlong, synthesize_latlong
from clrelight.lighting.light import Light
from clrelight.matmul import apply_operator, pack_operator
from clrelight.shrm.angular import integrate_on_device
from clrelight.shrm.expansion import expand_product
from clrelight.shrm.explicit import explicit_maps, view_grid
from clrelight.shrm.orders import phong_width, sufficient_coefficients
from clrelight.shrm.prefilter import build_shrm
from clrelight.shrm.record import grid_directions
from clrelight.shrm.spectrum import sum_degrees

EXPONENTS = (8, 16, 32, 64, 128, 256, 512)
SIGMAS = (0.1, 0.2, 0.3, 0.4, 0.5)
SIZE = 128
"""Rows and columns of light and of reflection maps in the paper's tables 4 and 5."""

ANGULAR_EPSILON, FREQUENCY_EPSILON = 0.05, 0.03
_REPEATS = 5
_VIEW = np.array([0.36, -0.8, 0.48])


def best_seconds(work: Callable[[], object], repeats: int = _REPEATS) -> float:
    """Return the least time of some runs after one that warms caches."""
    work()
    seconds = []
    for _ in range(repeats):
        since = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - since)
    return min(seconds)


def square_light(light: Light, size: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return a light as a map (size, size, channel), and its texels' directions and radiance times solid angle."""
    held = light.coeffs_kc[: coefficient_count(min(light.degree, (size - 1) // 2))]
    map_hwc = synthesize_latlong(held, size, size)
    weights_t = np.repeat(latitude_weights(size) * (2.0 * np.pi / size), size)
    directions_t3 = grid_directions(size, size).reshape(-1, 3)
    return map_hwc, directions_t3, weights_t[:, None] * map_hwc.reshape(size * size, -1)


def time_phong(
    light: Light, device: Device, size: int = SIZE, exponents: Sequence[float] = EXPONENTS
) -> list[dict[str, Any]]:
    """Return table 4: seconds of a size × size reflection map of Phong lobes by angles and by orders.

    The angular peer runs on the device in float32, within what a lobe sends on 95%; orders run on the host in float64,
    up to ``F = 1 + sqrt(6 s)``: both as the paper's.
    """
    map_hwc, directions_t3, weighted_tc = square_light(light, size)
    central_n3 = grid_directions(size, size).reshape(-1, 3)
    rows = []
    for s in exponents:
        degree = min(1 + math.ceil(math.sqrt(6.0 * s)), (size - 1) // 2)
        lobe = Phong(float(s))

        def by_orders(degree: int = degree, lobe: Phong = lobe) -> NDArray:
            projected = Light(project_latlong(map_hwc, degree))
            return build_shrm(projected, brdf_coefficients(lobe, degree, 0), size, size).maps_khwc

        def by_angles(lobe: Phong = lobe) -> NDArray:
            return integrate_on_device(
                device, directions_t3, weighted_tc, lobe, central_n3, _VIEW, epsilon=ANGULAR_EPSILON
            )

        angular_nc, angular = by_angles(), best_seconds(by_angles, 2)
        frequency = best_seconds(by_orders)
        found_nc = by_orders()[0].reshape(len(central_n3), -1) / math.sqrt(4.0 * math.pi)
        apart = float(np.linalg.norm(found_nc - angular_nc) / np.linalg.norm(found_nc))
        rows.append({"s": s, "degree": degree, "width": phong_width(s, ANGULAR_EPSILON), "angular": angular})
        rows[-1] |= {"frequency": frequency, "ratio": angular / frequency, "apart": apart}
    return rows


def time_microfacets(
    light: Light, device: Device, size: int = SIZE, sigmas: Sequence[float] = SIGMAS
) -> list[dict[str, Any]]:
    """Return table 5: seconds of one map by angles, of the whole reflection map by orders, and of 100 explicit maps."""
    map_hwc, directions_t3, weighted_tc = square_light(light, size)
    central_n3 = grid_directions(size, size).reshape(-1, 3)
    rows = []
    for sigma in sigmas:
        brdf = Microfacet(sigma)
        orders = sufficient_coefficients(brdf, FREQUENCY_EPSILON)

        def whole(orders: BrdfCoefficients = orders) -> Any:
            projected = Light(project_latlong(map_hwc, orders.degree))
            return build_shrm(projected, orders, size, size, frame="global")

        def by_angles(brdf: Microfacet = brdf) -> NDArray:
            return integrate_on_device(
                device, directions_t3, weighted_tc, brdf, central_n3, _VIEW, epsilon=ANGULAR_EPSILON
            )

        image = best_seconds(by_angles, 1)
        shrm, views = whole(), view_grid(10)
        seconds, explicit = best_seconds(whole), best_seconds(lambda: explicit_maps(shrm, views), 1)  # noqa: B023
        since = time.perf_counter()
        sufficient_coefficients(brdf, FREQUENCY_EPSILON)
        reflectance = time.perf_counter() - since
        rows.append({"sigma": sigma, "degree": orders.degree, "order": orders.order, "image": image})
        rows[-1] |= {"images": 100.0 * image, "reflectance": reflectance, "shrm": seconds}
        rows[-1] |= {"frequency": seconds + explicit, "ratio": 100.0 * image / (seconds + explicit)}
    return rows


def cost_slopes(size: int = SIZE) -> dict[str, dict[str, Any]]:
    """Return table 3: by what power of F, P and S the sum over orders grows, beside the theory's ``F P^2 S^2``.

    P counts as P + 1 and F as F + 1, as the paper says of small ones; slopes are least squares in logarithms.
    """
    measured: dict[str, tuple[list[float], list[float]]] = {
        "F": _grown((23, 35, 47, 71, 95), lambda f: _orders_seconds(f, 4, size)),
        "P": _grown((2, 3, 4, 6, 8), lambda p: _orders_seconds(31, p, 96)),
        "S": _grown((64, 96, 128, 160, 192), lambda s: _orders_seconds(31, 4, s), shift=0),
    }
    theory = {"F": 1.0, "P": 2.0, "S": 2.0}
    return {
        name: {"at": at, "seconds": seconds, "theory": theory[name], "slope": _slope(at, seconds)}
        for name, (at, seconds) in measured.items()
    }


def _grown(values: Sequence[int], measure: Callable[[int], float], shift: int = 1) -> tuple[list[float], list[float]]:
    return [float(value + shift) for value in values], [measure(value) for value in values]


def _slope(at: Sequence[float], seconds: Sequence[float]) -> float:
    return float(np.polyfit(np.log(at), np.log(seconds), 1)[0])


def _orders_seconds(degree: int, order: int, size: int) -> float:
    """Return the time of the sum over orders m, by a product in float64."""
    rng = np.random.default_rng(0)
    brdf = brdf_coefficients(Microfacet(0.3), degree, order)
    light = Light(rng.standard_normal((coefficient_count(degree), 1)))
    sums_hkmc = sum_degrees(light.coeffs_kc, brdf, size)
    seconds: list[float] = []

    def multiply(waves_wn: NDArray, parts_nx: NDArray) -> NDArray:
        since = time.perf_counter()
        product = waves_wn @ parts_nx
        seconds.append(time.perf_counter() - since)
        return product

    with threadpool_limits(1):  # threads of a busy machine wait for each other
        for _ in range(1 + _REPEATS):
            expand_product(sums_hkmc, size, multiply)
    return min(seconds[1:])


def frame_rates(order: int, device: Device) -> dict[str, float]:
    """Return how many dynamic RGB maps of six faces of 64 × 64 texels are summed a second (eq. 12; the paper: 30)."""
    rng = np.random.default_rng(0)
    count, texels = coefficient_count(order), 6 * 64 * 64 * 3
    maps_kx = rng.standard_normal((count, texels)).astype(np.float32)
    weights_1k = rng.standard_normal((1, count)).astype(np.float32)
    source, out = device.upload(maps_kx), device.empty((1, texels), np.float32)

    def on_device() -> None:
        apply_operator(device, pack_operator(device, weights_1k), source, out)
        device.download(out)

    return {"host": 1.0 / best_seconds(lambda: weights_1k @ maps_kx), "device": 1.0 / best_seconds(on_device)}


def prefilter_shares(map_hwc: NDArray[np.floating], sigma: float = 0.2, epsilon: float = 0.03) -> dict[str, float]:
    """Return the seconds of a whole reflection map of a map, beside those of projecting and reconstructing the map.

    Float32, as files hold. ``whole`` is projection, sums over degrees and orders; ``with_reflectance`` finds the
    reflectance's coefficients and orders too; ``transforms`` is projection to F and the map's own reconstruction from
    it, at its own size.
    """
    brdf = Microfacet(sigma)
    orders = sufficient_coefficients(brdf, epsilon)
    height, width = map_hwc.shape[:2]

    def whole(found: BrdfCoefficients) -> object:
        projected = Light(project_latlong(map_hwc, found.degree))
        return build_shrm(projected, found, 10 * found.degree, frame="global", dtype=np.float32)

    works = {
        "whole": lambda: whole(orders),
        "with_reflectance": lambda: whole(sufficient_coefficients(brdf, epsilon)),
        "transforms": lambda: synthesize_latlong(project_latlong(map_hwc, orders.degree), height, width),
    }
    # In turns: a busy machine is then alike for all.
    rounds = [{name: best_seconds(work, 1) for name, work in works.items()} for _ in range(2 * _REPEATS)]
    return {name: min(each[name] for each in rounds) for name in works}
