"""Lam, Leung and Wong, *Noise-Resistant Fitting for Spherical Harmonics*."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clrelight.experiment.portraits import portrait_of
from clrelight.experiment.scenes import survey_stack
from clrelight.fit.cls import plan_constrained
from clrelight.harmonics.hemisphere import hemisphere_autocorrelation
from clrelight.report import paper
from clrelight.report.canvas import house_style, new_figure
from clrelight.reproduction import exact
from clrelight.reproduction.complexity import TOLERANCE, table_two
from clrelight.reproduction.deletion import deletion
from clrelight.reproduction.eigenvectors import eigenvectors, figure_11
from clrelight.reproduction.parts import Part, lighting_of, ring_columns
from clrelight.reproduction.rows import LONG, SHORT, Bench, Between, Found, Holds, Near, Out, Paper, Row, Work, yes
from clrelight.reproduction.scenes import WORKS as SCENES
from clrelight.reproduction.vector_codecs import CODECS, vector_codecs
from clrelight.sampling import make_pattern
from datasets_synth.scenes import SCENES as RENDERED

PATTERNS = ("uniform", "grid", "scattered")
ROUNDS = 3
FIGURE_3_SIZE = {"ring": 256, "torus": 64, "dama": 64}
_SIGMA = 0.01


def _samplings(bench: Bench) -> Found:
    """Return figure 2's patterns, and the energy of each function on half a sphere, which is a half (below eq. 11)."""
    energy_k = np.diag(hemisphere_autocorrelation(6))
    values: dict[str, float] = {"half": float(np.abs(energy_k - 0.5).max())}
    drawn = {}
    for pattern in PATTERNS:
        directions_i3 = make_pattern(pattern, 256)
        drawn[pattern] = directions_i3
        values[f"{pattern} above"] = float(directions_i3[:, 2].min())
        third_i = np.floor(directions_i3[:, 2] * 4.0 - 1e-9)
        values[f"{pattern} even"] = float(np.bincount(third_i.astype(int), minlength=4).max() / 64.0)
    return Found(values, {"fitting_figure2.png": _draw_patterns(drawn)} if bench.draws else {})


def _draw_patterns(drawn: dict[str, np.ndarray]) -> Any:
    names = {"uniform": "(a) uniform", "grid": "(b) regular grid", "scattered": "(c) scattered"}
    with house_style():
        figure = new_figure(1100, 400, layout="constrained")
        for axes, (pattern, directions_i3) in zip(figure.subplots(1, 3), drawn.items(), strict=True):
            axes.scatter(directions_i3[:, 0], directions_i3[:, 1], s=5, color="#0072B2")
            axes.set_aspect("equal")
            axes.set_xlim(-1.05, 1.05)
            axes.set_ylim(-1.05, 1.05)
            axes.set_title(names[pattern])
            axes.set_axis_off()
        return figure


def _noise(bench: Bench) -> Found:
    """Return the energy that a relative error of 1% of the coefficients adds, over half its square times |c|^2."""
    samples_ip, directions_i3 = ring_columns(256)
    plan = plan_constrained(lighting_of(directions_i3), 6, 1.0)
    rng = np.random.default_rng(0)
    matrix_kk = hemisphere_autocorrelation(6)
    values = {}
    for name, coeffs_kp in (("uls", exact.fit_uls(plan, samples_ip)), ("cls", exact.fit_cls(plan, samples_ip))):
        kept_kp = coeffs_kp[:, :: max(1, coeffs_kp.shape[1] // 400)]
        found = []
        for _ in range(40):
            noise_kp = _SIGMA * rng.standard_normal(kept_kp.shape) * kept_kp
            found.append(np.einsum("kp,kj,jp->", noise_kp, matrix_kk, noise_kp))
        values[name] = float(np.mean(found) / (0.5 * _SIGMA**2 * np.sum(kept_kp**2)))
    energy_p, norm_p = plan.energy_i @ samples_ip**2, np.sum(exact.fit_cls(plan, samples_ip) ** 2, axis=0)
    values["bound"] = float(np.max(norm_p / np.maximum(energy_p, 1e-12)))
    return Found(values)


def _scenes(bench: Bench) -> Found:
    """Return figure 3: pictures of the three scenes, and that their functions are hemispherical."""
    values, panels = {}, []
    for name in ("ring", "torus", "dama"):
        stack = RENDERED[name].render({"size": FIGURE_3_SIZE[name], "lights": 64})
        values[name] = float(stack.directions_i3[:, 2].min())
        if bench.draws:
            panels.append(portrait_of(stack, survey_stack(stack), bench.open_device()).reference)
    return Found(values, {"fitting_figure3.jpg": _beside(panels)} if panels else {})


def _beside(panels: list[np.ndarray]) -> np.ndarray:
    """Return pictures of any height side by side, on white."""
    height = max(len(panel) for panel in panels)
    rest = [((0, height - len(panel)), (0, 0), (0, 0)) for panel in panels]
    return np.concatenate([np.pad(p, width, constant_values=255) for p, width in zip(panels, rest, strict=True)], 1)


def _of_part(make: Callable[[Bench], Part]) -> Callable[[Bench], Found]:
    def run(bench: Bench) -> Found:
        part = make(bench)
        values = {what: yes(holds) for what, holds in part.verdicts.items()}
        return Found(values | dict(part.numbers), part.figures if bench.draws else {})

    return run


def _says(item: str, where: str, *statements: str, expected: Any = None, reason: str = "") -> tuple[Row, ...]:
    return tuple(Row(item, what, "yes", where, what, Holds(), expected, reason) for what in statements)


def _complexity_rows() -> tuple[Row, ...]:
    rows: list[Row] = []
    for samples in ("hemispherical", "scattered"):
        for method in ("ULS", "Sloan ULS", "CLS", "CEB"):
            terms = [("projection with M", "Mn", 1), ("projection with n", "Mn", 1), ("synthesis with n", "n²", 2)]
            if method == "CLS":
                terms += [("search with n", "k n", 1), ("search with k", "k n", 1)]
            if method == "CEB":
                terms.append(("cut with n", "n", 1))
            name = f"{method}, {samples}"
            rows += [_complexity_row(f"{name}, {step}", f"O({term})", power) for step, term, power in terms]
    rows.append(_complexity_row("CEB as printed, scattered, cut with n", "O(n³)", 3))
    return tuple(rows)


def _complexity_row(name: str, term: str, power: int) -> Row:
    near = Near(float(power), TOLERANCE)
    return Row("table II", f"{name}: power", f"{power} of {term}", "table II", name, near,
               Between(power - 0.8, power + 0.6), _MACHINE)  # fmt: skip


_MACHINE = "of small sizes the time is that of memory, not of sums: synthesis writes n values for its n² sums"


_DELETION = (
    Row("section IV-D", "pairs of 49 functions whose condition is the least, to nine digits", "more than 100",
        "section IV-D", "alike", Between(100.0, 1176.0)),
    Row("section IV-D", "norms of one pixel among these pairs, largest over least", "42 over 6.51", "section IV-D",
        "apart", Between(42.0 / 6.51, 1000.0)),
    Row("section IV-D", "sets of 4 of 49 functions", "more than 200,000", "section IV-D", "fours",
        Between(200_000.0, 211_876.0)),
    Row("section IV-D", "n = 25: deleting the third function divides ‖c‖² by", "much less singular", "section IV-D",
        "y10", Between(5.0)),
    Row("section IV-D", "n = 49: deleting the third function divides ‖c‖² by", "does not work", "section IV-D",
        "y10 of 49", Between(0.0, 2.0), Between(2.0, 100.0),
        "it divides ‖c‖² by 30, but hundreds of times that of CLS are left"),
)  # fmt: skip
_EIGEN = (
    "the last combination of 49 has less than 1e-6 of its energy on the hemisphere",
    "the condition grows with n",
    "eigenvalues lie within 0 and 1 at n = 25",
    "eigenvalues lie within 0 and 1 at n = 49",
)
_SEARCH = ("‖c(λ)‖ falls with λ (eq. 22)", "the search ends within the bound, and on it to the last step")

PAPER = Paper(
    "fitting",
    paper.CITATION,
    (
        Work("samplings", (
            Row("figure 2", "energy of each function on the hemisphere, off 1/2 by at most", "1/2", "section IV-B",
                "half", Between(0.0, 1e-12)),
            *(Row("figure 2", f"{pattern}: least height of a light", "upper hemisphere", "figure 2",
                  f"{pattern} above", Between(0.0, 1.0)) for pattern in PATTERNS),
            Row("figure 2", "uniform: fullest quarter of the heights, of its share", "uniform", "figure 2a",
                "uniform even", Near(1.0, 0.05)),
            Row("figure 2", "scattered: fullest quarter of the heights, of its share", "a part of the sphere",
                "figure 2c", "scattered even", Between(1.05, 4.0)),
        ), _samplings, pictures={"fitting_figure2.png": "figure 2"}),
        Work("scenes", tuple(
            Row("figure 3", f"{name}: least height of a light", "hemispherical", "figure 3", name, Between(0.0, 1.0))
            for name in ("ring", "torus", "dama")
        ), _scenes, takes=SHORT, surfaces=True, pictures={"fitting_figure3.jpg": "figure 3"}),
        Work("noise", (
            *(Row("equation 11", f"extra error of {name.upper()} over σ²‖c‖²/2", "1", "equation 11", name,
                  Near(1.0, 0.15)) for name in ("uls", "cls")),
            Row("equation 17", "‖c‖² of CLS over E_c, at most", "≤ 1", "equation 17", "bound",
                Between(0.0, 1.0 + 1e-6)),
        ), _noise, takes=SHORT, surfaces=True),
        *SCENES,
        Work("deletion", _DELETION, _of_part(lambda bench: deletion()), takes=SHORT, surfaces=True),
        Work("eigenvectors", _says("equation 14", "section IV-C", *_EIGEN), _of_part(lambda bench: eigenvectors()),
             pictures={"fitting_eigenvectors.png": "equation 14"}),
        Work("search", _says("figure 11", "section V-B, figure 11", *_SEARCH), _of_part(lambda bench: figure_11()),
             surfaces=True, pictures={"fitting_figure_11.png": "figure 11"}),
        Work("complexity", _complexity_rows(),
             _of_part(lambda bench: table_two(bench.open_device(), ROUNDS)), takes=LONG),
        Work("codecs", (
            *_says("VQ, CPCA", "section III-B", *(f"{name}: CLS and CEB are ahead of ULS" for name in CODECS)),
            *_says("VQ, CPCA", "section V-E", "a few axes of CPCA keep 90% of ULS's squared norm"),
        ), _of_part(lambda bench: vector_codecs(bench.open_device())), takes=LONG, surfaces=True),
    ),
    (
        Out("web pages", "further pictures that the article names", "not part of the article"),
    ),
)  # fmt: skip
