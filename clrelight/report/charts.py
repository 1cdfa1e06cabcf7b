"""Charts of noise-resistant-fitting: coefficient magnitudes (figure 7), PSNR against wavelet rate (figure 15)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clrelight.errors import InputError
from clrelight.report.canvas import LEFT, WIDTH, label_ends, method_colours, new_figure, plain_log_axis
from clrelight.report.rows import all_methods, method_label, method_rank, parse_profile_key, rows_by_key, scene_rows
from clrelight.report.tables import PLAIN
from clrelight.results import Results

RATE_RANGE = (0.25, 8.0)
"""Bits per coefficient shown in figure 15, at least."""

CURVE_MARKERS = "os^Dv"


def figure_7(results: Results, scene: str, degree: int) -> Any | None:
    """Draw |c_k| of a typical pixel per method, each on its own scale (figure 7); None without profiles."""
    profiles = {
        method: np.abs(np.asarray(values, dtype=np.float64))
        for key, values in results.profiles.items()
        for name, method, profile_degree in [parse_profile_key(key)]
        if (name, profile_degree) == (scene, degree)
    }
    methods = sorted(profiles, key=method_rank)
    if not methods:
        return None
    for method, values in profiles.items():
        if values.ndim != 1 or values.size == 0:
            raise InputError(f"profile {scene}/{method}/{degree} has shape {values.shape}, expected (n_coeff,)")
    figure = new_figure(WIDTH, 165 + 230 * len(methods), layout="constrained")
    panels = figure.subplots(len(methods), 1, sharex=True, squeeze=False)[:, 0]
    colours = method_colours(all_methods(results))
    bands = math.isqrt(max(len(values) for values in profiles.values()) - 1) + 1
    for axes, method in zip(panels, methods, strict=True):
        values = profiles[method]
        finite = np.where(np.isfinite(values), values, 0.0)
        for band in range(0, bands, 2):
            axes.axvspan(band**2 - 0.5, (band + 1) ** 2 - 0.5, color="#f1f1f1", linewidth=0)
        axes.bar(np.arange(len(values)), finite, width=0.72, color=colours[method])
        largest = int(np.argmax(finite))
        scale = f"largest |c| = {finite[largest]:.3g} at k = {largest},  ‖c‖² = {np.sum(finite**2):.3g}"
        if lost := int(np.sum(~np.isfinite(values))):
            scale += f",  {lost} not finite"
        axes.set_title(method_label(method), color=colours[method], fontweight="bold")
        axes.set_title(scale, loc="right", fontsize=9)
        axes.set_ylabel("$|c_k|$", parse_math=True)
        axes.set_ylim(0, 1.08 * max(finite[largest], np.finfo(float).tiny))
        axes.margins(x=0)
        axes.locator_params(axis="y", nbins=4)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.tick_params(axis="x", length=0)
    panels[-1].set_xlim(-0.5, bands**2 - 0.5)
    panels[-1].set_xticks([(band**2 + (band + 1) ** 2 - 1) / 2 for band in range(bands)], range(bands))
    panels[-1].set_xlabel("coefficients k = l² … (l+1)² − 1, in bands of equal l (numbered)")
    figure.suptitle(f"{scene}, degree {degree}: one typical pixel", x=0.01, ha="left", fontsize=10)
    return figure


def figure_15(results: Results, scene: str, degree: int) -> Any | None:
    """Draw mean PSNR against the real wavelet rate, plain PSNR dashed (figure 15); None without wavelet rows."""
    rows = rows_by_key(row for row in scene_rows(results, scene) if row["degree"] == degree)
    curves: dict[str, list[tuple[float, float]]] = {}
    for (method, _, setting), row in rows.items():
        point = float(row["bits_per_coefficient"]), float(row["psnr_mean"])
        if setting.codec == "wavelet" and np.isfinite(point).all() and point[0] > 0:
            curves.setdefault(method, []).append(point)
    if not curves:
        return None
    figure = new_figure(WIDTH, 810)
    axes = figure.add_axes((LEFT / WIDTH, 0.115, 0.7, 0.825))
    colours = method_colours(all_methods(results))
    ends = []
    for i, method in enumerate(sorted(curves, key=method_rank)):
        bits, psnr = np.array(sorted(curves[method])).T
        axes.plot(bits, psnr, CURVE_MARKERS[i % len(CURVE_MARKERS)] + "-", color=colours[method], zorder=3)
        plain_row = rows.get((method, degree, PLAIN))
        plain = math.nan if plain_row is None else float(plain_row["psnr_mean"])
        label = method_label(method)
        if math.isfinite(plain):
            dashes = (5 * (i % 2), (5, 5))  # shifted, so that of two equal lines both are seen
            axes.axhline(plain, color=colours[method], linestyle=dashes, linewidth=0.9)
            label += f"   plain {plain:.2f}"
        ends.append((float(bits[-1]), float(psnr[-1]), label, colours[method]))
    every_bit = [bits for curve in curves.values() for bits, _ in curve]
    plain_log_axis(axes, min(RATE_RANGE[0], *every_bit) / 1.08, max(RATE_RANGE[1], *every_bit) * 1.08, base=2)
    axes.grid(True)
    axes.set_axisbelow(True)
    axes.set_xlabel("bits per coefficient, every side table included (log scale)")
    axes.set_ylabel("mean PSNR at the fitted lights (dB)")
    axes.set_title(f"{scene}, degree {degree}: wavelet coding (solid), plain coefficients (dashed)")
    label_ends(axes, ends)
    return figure
