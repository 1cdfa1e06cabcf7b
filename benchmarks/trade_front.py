"""Whether what `trade` says to take lies on the front of all settings: five stacks, small enough that all can be tried.

    CLRELIGHT_DATA=... python -m benchmarks.trade_front [--side 96] [--folder results/trade_front] [STACK ...]

`trade` runs first, on the middle of each stack. Then every method is fitted at every degree, and coded in all ways, but
for what cannot lie on the front of bytes: settings that something no larger would beat even if coding had gained `GAIN`
dB. The most that coding did gain is told; above `GAIN` the table would say nothing. Rows are kept in `--folder`, those
of `trade` are taken over, and the same command goes on there. Times play no part.
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.rti_stacks import DATA_VARIABLE, crop
from clrelight.cli.progress import progress_bar
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device, open_device
from clrelight.experiment.axes import Axes
from clrelight.experiment.bench import Bench
from clrelight.experiment.grid import CodecSetting, Experiment
from clrelight.experiment.pareto import Model, Trial, best_within, recommend
from clrelight.experiment.row import row_key
from clrelight.experiment.run import earlier_results
from clrelight.experiment.trade import sweep_trade
from clrelight.fit import FitMethod, method_class
from clrelight.harmonics.index import coefficient_count
from clrelight.jobs.ingest import ingest
from clrelight.jobs.report import Report
from clrelight.speed.tables import markdown_table
from clrelight.store import write_results

STACKS = {
    "loewenkopf": ("loewenkopf/jpg", "../dirs.lp", "srgb"),
    "cat": ("diligent/catPNG", "light_directions.txt", "linear"),
    "Single/Object1/material1": ("synthrti/Single/Object1/material1/Dome", "dirs.lp", "linear"),
    "Real/item2": ("realrti/item2", "dirs.lp", "linear"),
    "univr_dome": ("univr_dome", "dirs.lp", "srgb"),
}
"""By name: the folder in CLRELIGHT_DATA/stacks, its lights, and the transfer of its values."""
GAIN = 1.0
"""Decibels at held-out lights that coding is taken to gain at most: it leaves out noise."""
_FILLED = 0.97
"""Of a rate, what codecs fill at least."""
_SAME = 1.02
"""Sizes that differ by less are alike."""
_RANGE_DB = 10.0
"""Budgets are compared down to so much below the best."""
HEADERS = (
    *("stack", "settings of `trade`", "of the whole", "left out", "taken", "dB", "kB", "behind the front, dB"),
    *("of all would be", "dB", "kB", "worst of all budgets", "coding gained, dB"),
)


@dataclass(frozen=True)
class Verdict:
    """How far what trade takes lies from the front of all trials: where all were known, and within budgets of bytes."""

    taken: Trial
    best: Trial
    behind_db: float
    worst_db: float
    worst_bytes: int


def read_stack(name: str, side: int) -> LightStack:
    """Return the middle of a stack, so many pixels of each side."""
    folder, lights, transfer = STACKS[name]
    place = Path(os.environ[DATA_VARIABLE]) / "stacks" / folder
    stack: LightStack = ingest(place, report=Report(), lights=place / lights, transfer=transfer)
    return replace(crop(stack, side), name=name, notes=())


def judge(tried: Sequence[Trial], whole: Sequence[Trial]) -> Verdict:
    """Compare what trade recommends, and its best within budgets of bytes, with all trials."""
    everything = [*tried, *whole]
    taken, top = recommend(tried), best_within(everything, math.inf)
    worst, worst_bytes = 0.0, 0
    for size in sorted({trial.size for trial in everything}):
        there = best_within(everything, size)
        if there >= top - _RANGE_DB and there - best_within(tried, _SAME * size) > worst:
            worst, worst_bytes = there - best_within(tried, _SAME * size), size
    behind = best_within(everything, taken.size) - taken.psnr
    return Verdict(taken, recommend(everything), behind, worst, worst_bytes)


class _Keeping(Bench):
    """Fits each model once, whatever the order in which its settings come: maps lie in files of `folder`."""

    def __init__(self, stack: LightStack, experiment: Experiment, device: Device, folder: Path) -> None:
        super().__init__(stack, experiment, device, illustrated=False)
        self.folder = folder
        self.kept: dict[tuple[FitMethod | str, int | str], tuple[CoefficientMap, FitMethod, float]] = {}

    def _coefficients(self, method: FitMethod | str, degree: int | str) -> tuple[CoefficientMap, FitMethod, float]:
        if (method, degree) not in self.kept:
            coefficients, taken, seconds = super()._coefficients(method, degree)
            path = self.folder / f"{len(self.kept)}.npy"
            np.save(path, coefficients.coeffs_khwc)
            lent = replace(coefficients, coeffs_khwc=np.load(path, mmap_mode="r"))
            self.kept[method, degree] = lent, taken, seconds
        return self.kept[method, degree]


class Whole:
    """All settings of some axes on one stack: those that could lie on the front are measured."""

    def __init__(
        self, stack: LightStack, axes: Axes, out: Path, device: Device, known: Sequence[Trial], folder: Path
    ) -> None:
        self.shape, self.axes, self.out = stack.image_shape, axes, out
        one = Experiment((str(out),), ("auto",), (0,), (CodecSetting(),), axes.holdout)
        self.bench = _Keeping(stack, one, device, folder)
        self.results = earlier_results(out, False)
        self.rows = {row_key(row): row for row in [*(trial.row for trial in known), *self.results.table]}
        self.known = [trial for trial in known if trial.psnr > -math.inf]
        self.trials: list[Trial] = []
        self.left_out, self.gain = 0, -math.inf

    def run(self, name: str) -> None:
        """Measure plain fits, then what is coded, the smallest first."""
        with progress_bar(name) as bar:
            models = list(self._models())
            plain: list[Trial] = []
            for done, model in enumerate(models):
                bar(done, len(models), model.label)
                plain.append(self._measure(model, CodecSetting()))
            candidates = sorted(self._coded(plain), key=lambda each: (each[0], -each[1].psnr))
            for done, (size, base, setting) in enumerate(candidates):
                bar(done, len(candidates), f"{base.model.label}, {setting.picture_name}")
                if best_within(self.known, size) >= base.psnr + GAIN:
                    self.left_out += 1
                    continue
                trial = self._measure(base.model, setting)
                self.gain = max(self.gain, trial.psnr - base.psnr)

    def _models(self) -> Iterator[Model]:
        for method in self.axes.methods:
            for degree in self.axes.degrees:
                yield Model(method_class(method)(), degree)

    def _coded(self, plain: Sequence[Trial]) -> Iterator[tuple[int, Trial, CodecSetting]]:
        """Yield each way of coding each model, with the bytes that it may take at least."""
        height, width, channel = self.shape
        for base in plain:
            if base.psnr == -math.inf:
                continue
            for setting in (setting for ladder in self.axes.ladders() for setting in ladder):
                count = coefficient_count(base.model.degree) * height * width * channel
                yield math.floor(_FILLED * setting.expected_bits * count / 8.0), base, setting

    def _measure(self, model: Model, setting: CodecSetting) -> Trial:
        identity = self.bench.identity(model.method, model.degree, setting)
        key = row_key(identity)
        if key not in self.rows:
            self.results = self.bench.measure(self.results, identity, model.method, model.degree, setting)
            write_results(self.out, self.results)
            self.rows[key] = self.results.table[-1]
        trial = Trial(model, setting, self.rows[key])
        self.trials.append(trial)
        if trial.psnr > -math.inf:
            self.known.append(trial)
        return trial


def main() -> None:
    """Run both on each stack, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stacks", nargs="*", default=[*STACKS], metavar="STACK", help=", ".join(STACKS))
    parser.add_argument("--side", type=int, default=96, help="pixels of each side that are measured")
    parser.add_argument("--folder", type=Path, default=Path("results/trade_front"))
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.stacks if name not in STACKS]:
        parser.error(f"stacks are {', '.join(STACKS)}, got {unknown[0]!r}")
    arguments.folder.mkdir(parents=True, exist_ok=True)
    rows, device, axes = [], open_device(), Axes(megapixels=math.inf)
    for name in arguments.stacks:
        file = f"{name.replace('/', '_')}_{arguments.side}"
        stack = read_stack(name, arguments.side)
        tried = sweep_trade(stack, name, arguments.folder / f"{file}_trade.h5", axes, device=device)
        with tempfile.TemporaryDirectory(dir=arguments.folder) as fits:
            whole = Whole(stack, axes, arguments.folder / f"{file}_whole.h5", device, tried, Path(fits))
            whole.run(name)
        rows.append(_row(name, tried, whole))
        print(" | ".join(rows[-1]), flush=True)
    print(markdown_table(HEADERS, rows))


def _row(name: str, tried: Sequence[Trial], whole: Whole) -> list[str]:
    found = judge(tried, whole.trials)
    taken, best = found.taken, found.best
    return [
        *(name, str(len(tried)), str(len(whole.trials)), str(whole.left_out), taken.label, f"{taken.psnr:.2f}"),
        *(f"{taken.size / 1000:.1f}", f"{found.behind_db:.2f}", best.label, f"{best.psnr:.2f}"),
        *(f"{best.size / 1000:.1f}", f"{found.worst_db:.2f} dB at {found.worst_bytes / 1000:.1f} kB"),
        f"{whole.gain:.2f}",
    ]


if __name__ == "__main__":
    main()
