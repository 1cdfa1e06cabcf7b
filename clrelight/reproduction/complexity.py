"""Table II of noise-resistant-fitting measured: how the time of each step of a fit grows with n, M and k_lambda."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.fit import prepare_fit
from clrelight.fit.cls import plan_constrained
from clrelight.fit.prepare import FitReport, PreparedFit
from clrelight.fit.run import collect_fit
from clrelight.reproduction.parts import Part, lighting_of, prose, table
from clrelight.sampling import make_pattern
from clrelight.threads import on_one_thread

COLUMNS = 1 << 15
SIDE = 256
COMPONENTS = 1 << 23
"""Of what goes through a tile's components and does little with each: columns are so many that these, of all columns,
are equally many (32 MiB) for every n. With as many columns for each n those of small n would lie in a cache, those of
large n would not, and the slope would be that of the memory."""
SHRINK_LIGHTS = 256
"""The cut and the search do not see them."""
DEGREES = (7, 9, 11, 15)
LARGE_DEGREES = (11, 15, 19, 23)
"""Of what grows with n² or more: at lower ones the O(n) of writing coefficients is much of it."""
LIGHTS = (512, 1024, 2048)
STEPS = (32, 64, 128, 256)
TOLERANCE = 0.2
ALIKE_LIGHTS, ALIKE_DEGREE = 1024, 7
_CEB_COLUMNS = 256


@dataclass
class ProcessorTime(FitReport):
    """A report whose stages are the time of all processors, which others on a shared machine disturb less."""

    last: float = field(default_factory=time.process_time)

    def add(self, stage: str, since: float) -> float:
        """Add the processors' time since the last stage."""
        now = time.process_time()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self.last
        self.last = now
        return super().add("", since)


@dataclass(frozen=True)
class Slope:
    """One row: what is timed, against what, and the paper's order."""

    method: str
    term: str
    step: str
    variable: str
    paper: float
    sizes: Sequence[float]
    runs: Sequence[Callable[[], float]]
    columns: Sequence[int]


def table_two(device: Device, rounds: int) -> Part:
    """Return the table of slopes, hemispherical and scattered; processors' times are minima of interleaved rounds."""
    slopes = [slope for sampling in ("hemisphere", "scattered") for slope in _slopes(device, sampling)]
    best = [[np.inf] * len(slope.runs) for slope in slopes]
    for round_ in range(rounds + 1):  # the first builds the kernels
        for row, slope in enumerate(slopes):
            for column, run in enumerate(slope.runs):
                taken = run()
                if round_:
                    best[row][column] = min(best[row][column], taken)
    lines, verdicts, numbers = [], {}, {}
    for slope, totals in zip(slopes, best, strict=True):
        seconds = [total / count for total, count in zip(totals, slope.columns, strict=True)]
        found = float(np.polyfit(np.log(slope.sizes), np.log(seconds), 1)[0])
        near = abs(found - slope.paper) <= TOLERANCE
        name = f"{slope.method}, {slope.step} with {slope.variable}"
        verdicts[name], numbers[name] = near, found
        sizes = ", ".join(f"{size:.0f}" for size in slope.sizes)
        times = ", ".join(f"{1e9 * value:.0f}" for value in seconds)
        said = "yes" if near else "no"
        cells = [
            slope.method,
            slope.term,
            slope.step,
            slope.variable,
            sizes,
            times,
            f"{slope.paper:g}",
            f"{found:.2f}",
            said,
        ]
        lines.append(cells)
    headers = ["method, samples", "term", "step", "with", "sizes", "ns a column", "paper", "measured"]
    text = [
        "### Table II: orders, measured",
        "",
        prose(f"""Log-log slope of the time of each term of the paper's sums, its other sizes held. Nanoseconds of all
        processors a column (a pixel and channel) are minima of {rounds} interleaved rounds."""),
        "",
        table([*headers, f"within {TOLERANCE}"], lines),
        "",
        prose("""`ceb` of scattered samples costs us O(n² + Mn), not the paper's O(n³ + Mn): cut in the eigenbasis of
        the scaled matrix A* (eq. 29) its energy stays a running sum. The paper's way, which makes the
        coefficients anew for every k, is measured in NumPy. ULS and Sloan's are timed with the matrices of
        a spline of the same sizes: they themselves are cut where float32 cannot hold their coefficients.
        CLS is the bisection, 32 steps unless it says otherwise."""),
        "",
        prose("""n is what the step goes through: of synthesis the square root of coefficients times components, of the
        cut as printed the cube root of coefficients times components twice, since lights see fewer components than
        there are coefficients. The cut and the search, which do little with each component, have as many columns as
        make components of all columns 32 MiB for every n; the others have one number of columns for all."""),
    ]
    return Part("table II", "\n".join(text), verdicts, numbers=numbers)


def _slopes(device: Device, sampling: str) -> list[Slope]:
    """Return the rows of one kind of samples."""
    lights, alike = _make_stack(sampling, ALIKE_LIGHTS), [COLUMNS] * len(DEGREES)
    name = "hemispherical" if sampling == "hemisphere" else "scattered"
    rows = []
    for method, title in (("uls", "ULS"), ("sloan", "Sloan ULS"), ("cls", "CLS"), ("ceb", "CEB")):
        of_degrees = [_Timed(device, lights, method, degree, sampling) for degree in DEGREES]
        of_lights = [_Timed(device, _make_stack(sampling, count), method, ALIKE_DEGREE, sampling) for count in LIGHTS]
        of_large = [_Timed(device, lights, method, degree, sampling) for degree in LARGE_DEGREES]
        label, large = f"{title}, {name}", [timed.synthesis_size for timed in of_large]
        sizes = [timed.rank for timed in of_degrees]
        runs = [timed.stage("project") for timed in of_lights]
        rows.append(Slope(label, "Mn", "projection", "M", 1.0, LIGHTS, runs, [COLUMNS] * len(LIGHTS)))
        runs = [timed.stage("project") for timed in of_degrees]
        rows.append(Slope(label, "Mn", "projection", "n", 1.0, sizes, runs, alike))
        runs = [timed.stage("synthesize") for timed in of_large]
        rows.append(Slope(label, "n²", "synthesis", "n", 2.0, large, runs, alike))
        if method in ("cls", "ceb"):
            term, step = ("k n", "search") if method == "cls" else ("n", "cut")
            rows.append(_shrink_slope(device, method, sampling, (label, term, step)))
        if method == "cls":
            of_steps = [_Timed(device, lights, method, ALIKE_DEGREE, sampling, steps) for steps in STEPS]
            runs = [timed.stage("shrink") for timed in of_steps]
            rows.append(Slope(label, "k n", "search", "k", 1.0, STEPS, runs, alike))
    if sampling == "scattered":
        cuts = [_paper_cut(lights, degree) for degree in LARGE_DEGREES]
        counts, cut_runs = [count for count, _ in cuts], [run for _, run in cuts]
        columns = [_CEB_COLUMNS] * len(cuts)
        rows.append(Slope("CEB as printed, scattered", "n³", "cut", "n", 3.0, counts, cut_runs, columns))
    return rows


def _shrink_slope(device: Device, method: str, sampling: str, names: tuple[str, str, str]) -> Slope:
    """Return the row of what is done with each component, as many of them for every n (`COMPONENTS`)."""
    columns = [COMPONENTS // (degree + 1) ** 2 // SIDE * SIDE for degree in DEGREES]
    stacks = [_make_stack(sampling, SHRINK_LIGHTS, count) for count in columns]
    timed = [_Timed(device, stack, method, degree, sampling) for stack, degree in zip(stacks, DEGREES, strict=True)]
    return Slope(*names, "n", 1.0, [each.rank for each in timed], [each.stage("shrink") for each in timed], columns)


class _Timed:
    """A fit whose stages are timed, each by its own run."""

    def __init__(
        self, device: Device, stack: LightStack, method: str, degree: int, sampling: str, steps: int | None = None
    ) -> None:
        options = {"solver": "bisection", "iterations": steps or 32} if method == "cls" else {}
        if method in ("uls", "sloan"):  # a well-conditioned stand-in of the same sizes: uls proper is cut at float32
            method, options = "spline", {"lam": 1e-3}
        self._prepare = lambda: prepare_fit(
            stack, method, degree, options=options, sampling=sampling, precision="single", device=device
        )
        self._prepared: PreparedFit | None = None

    @property
    def rank(self) -> int:
        """Components."""
        return len(self._ready().plan.singular_r)

    @property
    def synthesis_size(self) -> float:
        """The square root of coefficients times components, n where all are kept."""
        plan = self._ready().plan
        return float((self._ready().degree + 1) * len(plan.singular_r) ** 0.5)

    def _ready(self) -> PreparedFit:
        if self._prepared is None:
            self._prepared = self._prepare()
        return self._prepared

    def stage(self, name: str) -> Callable[[], float]:
        """Return a run that says how long a stage took."""

        def run() -> float:
            report = ProcessorTime()
            collect_fit(replace(self._ready(), report=report), memory_bytes=1 << 40)
            return report.seconds[name]

        return run


def _make_stack(sampling: str, count: int, columns: int = COLUMNS) -> LightStack:
    pattern = "uniform" if sampling == "hemisphere" else "scattered"
    directions_i3 = make_pattern(pattern, count)
    rng = np.random.default_rng(0)
    normals_3p = rng.standard_normal((3, columns))
    shade_ip = np.maximum(directions_i3 @ (normals_3p / np.linalg.norm(normals_3p, axis=0)), 0.0)
    shade_ip += 0.2 * rng.random(shade_ip.shape)
    codes_ip = np.rint(255.0 * np.clip(shade_ip, 0.0, 1.0, out=shade_ip), out=shade_ip).astype(np.uint8)
    return LightStack(codes_ip.reshape(count, SIDE, -1, 1), directions_i3, 255.0)


def _paper_cut(stack: LightStack, degree: int) -> tuple[float, Callable[[], float]]:
    """Return n and a run of the eigenbasis as the paper has it for scattered samples: c anew for every k, O(n^2) each.

    Scattered lights see fewer components than there are coefficients, and c is made for as many k as there are
    components: n is the cube root of coefficients times components twice.
    """
    plan = plan_constrained(lighting_of(stack.directions_i3, "scattered"), degree, 1.0)
    samples_ip = stack.images_ihwc.reshape(stack.n_light, -1)[:, :_CEB_COLUMNS] / 255.0
    z_rp = plan.analysis_ri @ samples_ip / plan.singular_r[:, None]
    synthesis_kr = plan.synthesis_kr
    if synthesis_kr is None:
        raise ValueError("expected a least-squares plan, got one without a synthesis")

    def run() -> float:
        with on_one_thread():
            since = time.process_time()
            for rank in range(1, len(z_rp) + 1):
                coeffs_kp = synthesis_kr[:, :rank] @ z_rp[:rank]
                np.einsum("kp,kp->p", coeffs_kp, coeffs_kp)
            return time.process_time() - since

    return float((len(synthesis_kr) * len(z_rp) ** 2) ** (1.0 / 3.0)), run
