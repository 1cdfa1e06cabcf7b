"""What reflection maps cost beside integration over angles (frequency-space-environment-maps, tables 3 to 5)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from clrelight.brdf.analytic import Microfacet
from clrelight.brdf.coefficients import BrdfCoefficients, brdf_coefficients
from clrelight.brdf.radial import Phong
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.latlong import latitude_weights, project_latlong, synthesize_latlong
from clrelight.lighting.light import Light
from clrelight.lighting.projection_device import project_latlong_on_device
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
    return least_seconds({"": work}, repeats)[""]


def least_seconds(works: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return each way's least time of rounds that take all in turns: other programs only ever add to times."""
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for turn in range(rounds + 1):  # the first one warms caches
        for name, work in works.items():
            since = time.perf_counter()
            work()
            if turn:
                seconds[name].append(time.perf_counter() - since)
    return {name: min(found) for name, found in seconds.items()}


def square_light(light: Light, size: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return a light as a map (size, size, channel), and its texels' directions and radiance times solid angle."""
    held = light.coeffs_kc[: coefficient_count(min(light.degree, (size - 1) // 2))]
    map_hwc = synthesize_latlong(held, size, size)
    weights_t = np.repeat(latitude_weights(size) * (2.0 * np.pi / size), size)
    directions_t3 = grid_directions(size, size).reshape(-1, 3)
    return map_hwc, directions_t3, weights_t[:, None] * map_hwc.reshape(size * size, -1)


def check_lit(light: Light) -> None:
    """Raise InputError where a light is black: errors are told as parts of what it sends."""
    if not np.any(light.coeffs_kc):
        raise InputError("the map is black, and errors of reflection are parts of its light: take one that is lit")


def time_phong(
    light: Light, device: Device, size: int = SIZE, exponents: Sequence[float] = EXPONENTS
) -> list[dict[str, Any]]:
    """Return table 4: seconds of a size × size reflection map of Phong lobes by angles and by orders.

    The angular peer runs on the device, within what a lobe sends on 95%; so do sums of orders, up to
    ``F = 1 + sqrt(6 s)``, as the paper's: both in float32.
    """
    map_hwc, directions_t3, weighted_tc = square_light(light, size)
    central_n3 = grid_directions(size, size).reshape(-1, 3)
    rows = []
    for s in exponents:
        degree = min(1 + math.ceil(math.sqrt(6.0 * s)), (size - 1) // 2)
        lobe = Phong(float(s))

        def by_orders(degree: int = degree, lobe: Phong = lobe) -> NDArray:
            projected = Light(project_latlong(map_hwc, degree))
            orders = brdf_coefficients(lobe, degree, 0)
            return build_shrm(projected, orders, size, size, method="device", dtype=np.float32, device=device).maps_khwc

        def by_angles(lobe: Phong = lobe) -> NDArray:
            return integrate_on_device(
                device, directions_t3, weighted_tc, lobe, central_n3, _VIEW, epsilon=ANGULAR_EPSILON
            )

        angular_nc, angular = by_angles(), best_seconds(by_angles, 2)
        frequency = best_seconds(by_orders, 100 * _REPEATS)
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
        seconds, explicit = best_seconds(whole, 4 * _REPEATS), best_seconds(lambda: explicit_maps(shrm, views), 1)  # noqa: B023
        since = time.perf_counter()
        sufficient_coefficients(brdf, FREQUENCY_EPSILON)
        reflectance = time.perf_counter() - since
        rows.append({"sigma": sigma, "degree": orders.degree, "order": orders.order, "image": image})
        rows[-1] |= {"images": 100.0 * image, "reflectance": reflectance, "shrm": seconds}
        rows[-1] |= {"frequency": seconds + explicit, "ratio": 100.0 * image / (seconds + explicit)}
    return rows


def cost_slopes(size: int = SIZE, rounds: int = 4 * _REPEATS) -> dict[str, dict[str, Any]]:
    """Return table 3: by what power of F, P and S the sum over orders grows, beside the theory's ``F P^2 S^2``.

    P counts as P + 1 and F as F + 1, as the paper says of small ones; slopes are least squares in logarithms, of the
    least times of rounds that take all sizes in turns.
    """
    cases = {
        "F": {f + 1: (f, 4, size) for f in (23, 35, 47, 71, 95)},
        "P": {p + 1: (31, p, 96) for p in (2, 3, 4, 6, 8)},
        "S": {s: (31, 4, s) for s in (64, 96, 128, 160, 192)},
    }
    works = {f"{name}{at}": _orders_work(*case) for name, own in cases.items() for at, case in own.items()}
    with threadpool_limits(1):  # threads of a busy machine wait for each other
        found = least_seconds(works, rounds)
    slopes = {}
    for name, theory in {"F": 1.0, "P": 2.0, "S": 2.0}.items():
        at = [float(value) for value in cases[name]]
        seconds = [found[f"{name}{value}"] for value in cases[name]]
        slope = float(np.polyfit(np.log(at), np.log(seconds), 1)[0])
        slopes[name] = {"at": at, "seconds": seconds, "theory": theory, "slope": slope}
    return slopes


def _orders_work(degree: int, order: int, size: int) -> Callable[[], object]:
    """Return the sum over orders m of a map of size × size texels, a product in float64, ready to be run."""
    light = Light(np.random.default_rng(0).standard_normal((coefficient_count(degree), 1)))
    sums_hkmc = sum_degrees(light.coeffs_kc, brdf_coefficients(Microfacet(0.3), degree, order), size)
    factors: list[NDArray] = []

    def keep(waves_wn: NDArray, parts_nx: NDArray) -> NDArray:
        factors.extend((waves_wn, parts_nx))
        return np.zeros((len(waves_wn), parts_nx.shape[1]))

    expand_product(sums_hkmc, size, keep)
    made_wx = np.empty((size, factors[1].shape[1]))
    waves_wn, parts_nx = factors
    return lambda: np.matmul(waves_wn, parts_nx, out=made_wx)


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


def prefilter_works(
    map_hwc: NDArray[np.floating], device: Device, sigma: float = 0.2, epsilon: float = 0.03
) -> dict[str, Callable[[], object]]:
    """Return what makes a whole reflection map of a map, and what projects and reconstructs the map itself.

    Float32, as files hold. ``whole`` is projection and sums over degrees and orders with kernels, ``host`` the same
    without; ``with_reflectance`` finds the reflectance's coefficients and orders too; ``transforms`` is projection to
    F, of whichever way is the faster one, and the map's own reconstruction from it, at its own size.
    """
    brdf = Microfacet(sigma)
    orders = sufficient_coefficients(brdf, epsilon)
    height, width = map_hwc.shape[:2]

    def whole(found: BrdfCoefficients, method: str = "device") -> object:
        project = project_latlong if method == "fft" else partial(project_latlong_on_device, device=device)
        light = Light(project(map_hwc, found.degree))
        rows = 10 * found.degree
        return build_shrm(light, found, rows, frame="global", method=method, dtype=np.float32, device=device)

    def transforms() -> object:
        return synthesize_latlong(project_latlong_on_device(map_hwc, orders.degree, device), height, width)

    return {
        "whole": lambda: whole(orders),
        "host": lambda: whole(orders, "fft"),
        "with_reflectance": lambda: whole(sufficient_coefficients(brdf, epsilon)),
        "transforms": transforms,
    }


def prefilter_shares(map_hwc: NDArray[np.floating], device: Device) -> dict[str, float]:
    """Return the least seconds of each of `prefilter_works`."""
    return least_seconds(prefilter_works(map_hwc, device), 4 * _REPEATS)
