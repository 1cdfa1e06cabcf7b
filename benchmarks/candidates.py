"""What other weights, another domain or a model for each channel would give: ``python -m benchmarks.candidates``.

`spectrum` at lights in the gaps between those fitted, as it is and with what `auto` could choose beside: solid-angle
weights; values on the sRGB curve instead of radiance, whatever errors are measured in; parameters for each channel;
and `spline` of degree 15 with lambda for each channel. "Promised" is what lights left out with their neighbours say,
by which a candidate would be taken. Scenes: SynthRTI, RealRTI, loewenkopf (CLRELIGHT_DATA), the ring and the domes of
`benchmarks.auto_grid`. A sample of the pixels is fitted, the same for all.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.auto_domes import mean_psnr
from benchmarks.auto_grid import COLUMNS, keep_gaps, split_dome, split_lion, split_ring
from benchmarks.choice import list_splits
from benchmarks.pages import replace_block
from clrelight.dataset import LightStack
from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.fit import prepare_fit
from clrelight.fit.leave_out_error import Trials, krige_left_out
from clrelight.fit.registry import method_class
from clrelight.fit.samples import Samples
from clrelight.fit.spectrum import SpectrumFit
from clrelight.fit.zonal import LARGEST_DEGREE
from clrelight.harmonics.basis import evaluate_basis

COUNTS = (6, 9, 16, 25, 49)
BEGIN, END = "<!-- candidates -->", "<!-- /candidates -->"
CANDIDATES = (
    "solid-angle weights",
    "`spectrum-curve`, code values linear",
    "`spectrum-curve`, code values sRGB",
    "parameters for each channel",
    "`spline` 15, λ for each channel",
)
HEADERS = "candidate", "scenes", "mean, dB", "worst", "best", "taken", "mean, dB", "worst", "time"
CURVE = "spectrum-curve"
SETS = "domes", "lion", "real", "synth"
_LEAST = 1e-6
"""A smaller mean squared error counts as this."""
_CLEAR = 0.5, 3.0
"""Decibels, and standard errors, by which lights left out must promise more for a candidate to be taken."""

Row = tuple[str, str, float, float, bool, float]
"""Scene, candidate, decibels gained, promised, whether it would be taken, and processor time in units of before."""


def list_cases(data: Path | None, sets: Sequence[str]) -> Iterator[tuple[str, LightStack, LightStack]]:
    """Yield name, lights to fit and lights to test."""
    for count in COUNTS if "domes" in sets else ():
        for name in ("cubic", "Lambert", "gloss"):
            yield f"{name} {count}", *split_dome(name, count)
        yield f"ring {count}", *split_ring(count)
    if data is None:
        return
    for count in COUNTS if "lion" in sets else ():
        lion = split_lion(count)
        assert lion is not None  # more lights than any count
        yield f"loewenkopf {count}", *lion
    with tempfile.TemporaryDirectory() as scratch:
        for only in {"real", "synth"}.intersection(sets):
            for name, seen, tested in list_splits(data, Path(scratch), only):
                yield name, Samples(seen, COLUMNS).stack, Samples(tested, COLUMNS).stack


class Fitted:
    """`spectrum` of a stack, and its errors."""

    def __init__(self, seen: LightStack, weights: str = "uniform") -> None:
        start = time.process_time()
        self.samples = Samples(seen)
        trials = Trials.make(self.samples, weights, "hemisphere")
        settled = SpectrumFit().settle(trials.lighting, LARGEST_DEGREE, trials.samples)
        assert isinstance(settled, SpectrumFit)
        self.model = settled.model(trials.lighting)
        said_gp, _ = krige_left_out(self.model.plain, trials.mean_gp, trials.zones)
        self.promised_g = measure(said_gp, trials.mean_gp)
        self.seconds = time.process_time() - start

    def test(self, tested: LightStack) -> NDArray[np.float64]:
        """Return the PSNR at each light."""
        shown_tp = self.model.weights_at(tested.directions_i3) @ self.samples.radiance_ip
        return measure(shown_tp, tested.images_ihwc.reshape(tested.n_light, -1) / tested.peak)


def measure(shown_tp: NDArray[np.float64], true_tp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the PSNR in dB of each light."""
    return np.asarray(
        -10.0 * np.log10(np.maximum(np.mean((np.clip(shown_tp, 0.0, 1.0) - true_tp) ** 2, axis=1), _LEAST))
    )


def compare(name: str, seen: LightStack, tested: LightStack) -> Iterator[Row]:
    """Yield what each candidate gains."""
    tested = keep_gaps(seen, tested)
    code, even = Fitted(seen), Fitted(seen, "solid-angle")
    gain_g = even.promised_g - code.promised_g
    sure = gain_g.mean() - _CLEAR[1] * gain_g.std(ddof=1) / np.sqrt(len(gain_g)) >= _CLEAR[0]
    gain = float(np.mean(even.test(tested) - code.test(tested)))
    yield name, CANDIDATES[0], gain, float(gain_g.mean()), bool(sure), even.seconds / code.seconds + 1.0
    for candidate, transfer in zip(CANDIDATES[1:3], ("linear", "srgb"), strict=True):
        yield name, candidate, *_try_curve(replace(seen, transfer=transfer), replace(tested, transfer=transfer))
    channels = seen.image_shape[2]
    if channels > 1:
        one = [_channel(seen, channel) for channel in range(channels)]
        each = [Fitted(stack) for stack in one]
        error_tc = [
            10.0 ** (-0.1 * part.test(_channel(tested, channel))) for channel, part in enumerate(each)
        ]  # the mean over channels of squared errors is that of the image
        gain = float(np.mean(-10.0 * np.log10(np.mean(error_tc, axis=0)) - code.test(tested)))
        yield name, CANDIDATES[3], gain, np.nan, True, sum(part.seconds for part in each) / code.seconds
    yield name, CANDIDATES[4], *_try_spline(seen, tested)


def _try_curve(seen: LightStack, tested: LightStack) -> tuple[float, float, bool, float]:
    device, seconds = open_device(None), [time.process_time()]
    prepared = []
    for method in ("auto", "spectrum", "spectrum-curve"):
        prepared.append(prepare_fit(seen, method, "auto", device=device))
        seconds.append(time.process_time())
    reached = [mean_psnr(one, tested) for one in prepared]
    choice, spent = prepared[0].choice, np.diff(seconds)
    promised = np.nan if choice is None or choice.code_gain is None else choice.code_gain
    taken = prepared[0].method.id == CURVE
    return reached[2] - reached[1], promised, taken, float(spent[1:].sum() / spent[1])


def _channel(stack: LightStack, channel: int) -> LightStack:
    return replace(stack, images_ihwc=np.ascontiguousarray(stack.images_ihwc[..., channel : channel + 1]))


def _try_spline(seen: LightStack, tested: LightStack) -> tuple[float, float, bool, float]:
    basis_tk, reached, seconds = evaluate_basis(tested.directions_i3, 15), [], []
    trials = Trials.make(Samples(seen), "uniform", "hemisphere")
    samples_ip = Samples(seen).radiance_ip
    for per in ("stack", "channel"):
        start = time.process_time()
        settled = method_class("spline").from_config({"per": per}).settle(trials.lighting, 15, Samples(seen))
        plan = settled.plan(trials.lighting, 15)
        z_rp = plan.analysis_ri @ samples_ip
        gain_rp = settled.find_gains(plan, z_rp, plan.energy_i @ samples_ip**2)
        basis_tr = basis_tk if plan.synthesis_kr is None else basis_tk @ plan.synthesis_kr
        true_tp = tested.images_ihwc.reshape(tested.n_light, -1) / tested.peak
        reached.append(measure(np.clip(basis_tr @ (gain_rp * z_rp), 0.0, 1.0), true_tp).mean())
        seconds.append(time.process_time() - start)
    return float(reached[1] - reached[0]), np.nan, True, seconds[1] / seconds[0]


def sum_up(rows: Sequence[Row]) -> str:
    """Return a Markdown table: gains of each candidate, of all scenes and as it would be taken."""
    lines = ["| " + " | ".join(HEADERS) + " |", "|---" * len(HEADERS) + "|"]
    for candidate in CANDIDATES:
        some = [row for row in rows if row[1] == candidate]
        if not some:
            continue
        gains = np.array([row[2] for row in some])
        taken = np.array([row[2] if row[4] else 0.0 for row in some])
        figures = [f"{gains.mean():+.2f}", f"{gains.min():+.2f}", f"{gains.max():+.2f}"]
        figures += [f"{sum(row[4] for row in some)}", f"{taken.mean():+.2f}", f"{taken.min():+.2f}"]
        time_taken = f"{np.median([row[5] for row in some]):.1f}"
        lines.append("| " + " | ".join([candidate, str(len(some)), *figures, time_taken]) + " |")
    return "\n".join(lines)


def read_rows(paths: Sequence[Path]) -> list[Row]:
    """Return the rows that were printed."""
    found: list[Row] = []
    for path in paths:
        cells = [[cell.strip() for cell in line.split("|")] for line in path.read_text(encoding="utf-8").splitlines()]
        for name, candidate, *figures in (row for row in cells if len(row) == 6 and row[1] in CANDIDATES):
            gain, promised, taken, cost = figures
            found.append((name, candidate, float(gain), float(promised), taken == "taken", float(cost)))
    return found


def main() -> None:
    """Print each scene's rows, and their sum as a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", choices=SETS, help="Default: all.")
    parser.add_argument("--rows", action="append", type=Path, help="Measure nothing: sum up what was printed here.")
    parser.add_argument("--markdown", type=Path, help=f"Fill what stands between {BEGIN} and {END}.")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    data, rows = os.environ.get("CLRELIGHT_DATA"), read_rows(given.rows or ())
    cases = () if given.rows else list_cases(Path(data) if data else None, given.only or SETS)
    for name, seen, tested in cases:
        try:
            found = list(compare(name, seen, tested))
        except InputError as error:
            print(f"{name}: {error}", flush=True)
            continue
        rows += found
        for _, candidate, gain, promised, taken, cost in found:
            said = "taken" if taken else "left"
            print(f"{name} | {candidate} | {gain:+.2f} | {promised:+.2f} | {said} | {cost:.1f}", flush=True)
    table = sum_up(rows)
    print(table)
    if given.markdown is not None:
        replace_block(given.markdown, table, BEGIN, END)


if __name__ == "__main__":
    main()
