"""Why least squares on a hemisphere gives large coefficients: noise-resistant-fitting, eq. 12-14 and figure 11."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.cls import plan_constrained
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.decomposition import decompose
from clrelight.harmonics.hemisphere import hemisphere_autocorrelation
from clrelight.report.canvas import house_style, new_figure
from clrelight.reproduction.parts import Part, lighting_of, name_of, prose, ring_columns, table

DEGREES = (2, 4, 6, 8, 10)
_DISC = 201
FIGURE_11_FUNCTIONS = (0, 2)
"""y00 and y10: over a hemisphere they are nearly alike."""
_STEPS = 8


def eigenvectors() -> Part:
    """Return the eigenvalues of A, the function of its last eigenvector, and a picture of both."""
    lines, last = [], {}
    for degree in DEGREES:
        values_k, vectors_kk = np.linalg.eigh(hemisphere_autocorrelation(degree))
        # Of a unit vector the energy on the hemisphere is its eigenvalue, on the sphere 1.
        last[degree] = values_k[0]
        largest = int(np.argmax(np.abs(vectors_kk[:, 0])))
        zonal = float(sum(vectors_kk[l * (l + 1), 0] ** 2 for l in range(degree + 1)))
        lines.append(
            [
                str((degree + 1) ** 2),
                f"{values_k[-1]:.4f}",
                f"{values_k[0]:.3g}",
                f"{values_k[-1] / values_k[0]:.3g}",
                f"{1.0 / values_k[0]:.3g}",
                f"{np.sum(values_k < 1e-3)}",
                f"{name_of(largest)}, {100 * zonal:.0f}%",
            ]
        )
    headers = ["n", "largest eigenvalue of A", "least", "condition", "‖c‖² per unit of energy missed", "below 0.001"]
    text = [
        "### Combinations that a hemisphere does not see (eq. 12 to 14)",
        "",
        table([*headers, "last: largest part, zonal"], lines),
        "",
        prose(f"""The eigenvalue of a unit vector is the energy of its function on the upper hemisphere; on the sphere
        it has 1. The last one of 49 has {last[6]:.2g} there: a combination of unit norm that lights above
        the horizon see as nothing, so that a rounding error of the samples decides how much of it a pixel
        gets. It is all zonal, which is why deleting any low zonal function mends as much as another."""),
        "",
        "![Eigenvalues of A, and three eigenvectors' functions on both hemispheres](images/fitting_eigenvectors.png)",
    ]
    halves = {f"eigenvalues lie within 0 and 1 at n = {(d + 1) ** 2}": _within(d) for d in (4, 6)}
    verdicts = {
        "the last combination of 49 has less than 1e-6 of its energy on the hemisphere": bool(last[6] < 1e-6),
        "the condition grows with n": bool(np.all(np.diff([last[d] for d in DEGREES]) < 0)),
        **halves,
    }
    return Part("eigenvectors", "\n".join(text), verdicts, {"fitting_eigenvectors.png": _draw_eigenvectors()})


def _within(degree: int) -> bool:
    """Return whether eigenvalues are parts of a whole, as energies on half a sphere must be."""
    values_k = np.linalg.eigvalsh(hemisphere_autocorrelation(degree))
    return bool(np.max(values_k) <= 1.0 + 1e-12 and np.min(values_k) >= -1e-12)


def _draw_eigenvectors() -> Any:
    with house_style():
        figure = new_figure(1100, 460, layout="constrained")
        grid = figure.add_gridspec(2, 5, width_ratios=[2.4, 1, 1, 1, 0.08])
        axes = figure.add_subplot(grid[:, 0])
        for degree in DEGREES:
            values_k = np.linalg.eigvalsh(hemisphere_autocorrelation(degree))[::-1]
            axes.semilogy(np.arange(1, len(values_k) + 1), values_k, label=f"n = {len(values_k)}")
        axes.set_xlabel("eigenvalue, in descending order")
        axes.set_ylabel("energy of the function on the hemisphere")
        axes.legend(frameon=False)
        # Eigenvalues coincide: these vectors do not depend on LAPACK.
        vectors_kk = decompose(hemisphere_autocorrelation(6)).right_kr
        shown = {"first of 49": vectors_kk[:, 0], "25th": vectors_kk[:, 24], "last": vectors_kk[:, -1]}
        for column, (name, vector_k) in enumerate(shown.items(), start=1):
            for row, side in enumerate((1.0, -1.0)):
                disc = figure.add_subplot(grid[row, column])
                picture = disc.imshow(_over_disc(vector_k, side), cmap="RdBu_r", vmin=-1.5, vmax=1.5, origin="lower")
                disc.set_axis_off()
                disc.set_title(f"{name}: {'above' if side > 0 else 'below'}", fontsize=9)
        figure.colorbar(picture, cax=figure.add_subplot(grid[:, 4]))
        return figure


def _over_disc(vector_k: NDArray[np.float64], side: float) -> NDArray[np.float64]:
    """Return the function over one hemisphere seen along the axis, NaN outside."""
    x, y = np.meshgrid(*[np.linspace(-1.0, 1.0, _DISC)] * 2)
    inside = x**2 + y**2 < 1.0
    z = np.sqrt(np.where(inside, 1.0 - x**2 - y**2, 0.0)) * side
    values = evaluate_basis(np.stack([x, y, z], -1)[inside], 6) @ vector_k
    picture = np.full(x.shape, np.nan)
    picture[inside] = values
    return picture


def figure_11() -> Part:
    """Return figure 11: two coefficients of one pixel, the bound, the errors' ellipses and the search's steps."""
    samples_ip, directions_i3 = ring_columns(256)
    basis_i2 = evaluate_basis(directions_i3, 1)[:, FIGURE_11_FUNCTIONS]
    plan = plan_constrained(lighting_of(directions_i3), 1, 1.0)
    free_2p = np.linalg.lstsq(basis_i2, samples_ip, rcond=None)[0]
    energy_p = plan.energy_i @ samples_ip**2
    # The pixel whose least squares leave the bound furthest behind, in these two functions.
    pixel = int(np.argmax(np.sum(free_2p**2, axis=0) / np.maximum(energy_p, 1e-3)))
    beta_i, energy = samples_ip[:, pixel], float(energy_p[pixel])
    matrix, right = basis_i2.T @ basis_i2, basis_i2.T @ beta_i
    steps = _paper_search(matrix, right, energy)
    ends = [_solve(matrix, right, value) for value in steps]
    final = ends[-1]
    monotone = np.diff([np.sum(_solve(matrix, right, value) ** 2) for value in np.geomspace(1e-3, 1e3, 50)]) < 0
    text = [
        "### Figure 11: the search",
        "",
        prose(f"""The coefficients of y00 and y10 of one pixel of the ring. Ellipses: equal errors around the
        least-squares solution (cross). Circle: ‖c‖² = E_c = {energy:.3g}. The curve is c(λ), from least
        squares to 0; the dots are what the paper's search tries, from λ = 1 on, and the large one is where
        it ends: {", ".join(f"{value:.4g}" for value in steps)}."""),
        "",
        "![Two coefficients: the bound, ellipses of equal error, c(λ), and the search](images/fitting_figure_11.png)",
    ]
    verdicts = {
        "‖c(λ)‖ falls with λ (eq. 22)": bool(monotone.all()),
        "the search ends within the bound, and on it to the last step": bool(
            np.sum(final**2) <= energy * (1 + 1e-9) and np.sum(final**2) > 0.8 * energy
        ),
    }
    drawn = _draw_figure_11(matrix, right, energy, ends)
    return Part("figure 11", "\n".join(text), verdicts, {"fitting_figure_11.png": drawn})


def _solve(matrix: NDArray[np.float64], right: NDArray[np.float64], value: float) -> NDArray[np.float64]:
    return np.asarray(np.linalg.solve(matrix + value * np.eye(2), right), np.float64)


def _paper_search(matrix: NDArray[np.float64], right: NDArray[np.float64], energy: float) -> list[float]:
    """Return the lambdas that section V-C's search tries: from 1, lower bound 0, and the last that holds at the end."""
    low, high, value, tried = 0.0, None, 1.0, []
    for _ in range(_STEPS):
        tried.append(value)
        if np.sum(_solve(matrix, right, value) ** 2) <= energy:
            high = value
        else:
            low = value
        value = 2.0 * value if high is None else 0.5 * (low + high)
    return [*tried, value if high is None else high]


def _draw_figure_11(
    matrix: NDArray[np.float64], right: NDArray[np.float64], energy: float, ends: list[NDArray[np.float64]]
) -> Any:
    free = np.linalg.solve(matrix, right)
    with house_style():
        figure = new_figure(640, 560, layout="constrained")
        axes = figure.add_subplot()
        reach = 1.25 * max(np.abs(free).max(), np.sqrt(energy))
        x, y = np.meshgrid(*[np.linspace(-reach, reach, 241)] * 2)
        away = np.stack([x - free[0], y - free[1]], -1)
        error = np.einsum("...i,ij,...j->...", away, matrix, away)
        axes.contour(x, y, np.sqrt(error), levels=12, colors="#999999", linewidths=0.7)
        angle = np.linspace(0.0, 2.0 * np.pi, 361)
        axes.plot(np.sqrt(energy) * np.cos(angle), np.sqrt(energy) * np.sin(angle), color="black")
        way = np.array([_solve(matrix, right, value) for value in np.geomspace(1e-3, 1e5, 400)])
        axes.plot(*way.T, color="#1f77b4")
        axes.plot(*free, "x", color="#d62728", markersize=9, markeredgewidth=2)
        for number, end in enumerate(ends[:-1], start=1):
            axes.plot(*end, "o", color="#1f77b4", markersize=4)
            if number <= 4:
                aside = (8, 6) if number % 2 else (-14, -10)
                axes.annotate(str(number), end, textcoords="offset points", xytext=aside, fontsize=9)
        axes.plot(*ends[-1], "o", color="#2ca02c", markersize=8)
        axes.set_aspect("equal")
        axes.set_xlabel("coefficient of y00")
        axes.set_ylabel("coefficient of y10")
        return figure
