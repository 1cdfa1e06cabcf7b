"""What a user can give up, and what it saves: a sweep over methods, degrees, solvers, precision, lights and rates."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import replace

from clrelight.dataset import LightStack
from clrelight.device import Device, open_device
from clrelight.durable import claiming, no_locks
from clrelight.errors import InputError
from clrelight.experiment.axes import HALF, LEAST_LIGHTS, Axes
from clrelight.experiment.bench import Bench
from clrelight.experiment.excerpt import excerpt_of, in_memory
from clrelight.experiment.grid import CodecSetting, Experiment, make_settings
from clrelight.experiment.pareto import (
    Model,
    Trial,
    best_of_degrees,
    best_within,
    find_reference,
    near_pareto_front,
    storage_label,
)
from clrelight.experiment.row import row_key
from clrelight.experiment.run import Progress, earlier_results
from clrelight.experiment.scenes import survey_stack
from clrelight.fit import method_class
from clrelight.fit.precision import MIXED, check_precision, differing_precisions
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.decomposition import decompose
from clrelight.harmonics.index import coefficient_count
from clrelight.store import write_results

REPEATS = 3
_MAX_CONDITION = 1e6
"""Of the basis matrix, up to which unbounded fits are tried."""
_UNBOUNDED = ("uls", "sloan")
_NEAR = 0.3
"""Decibels by which a smaller and faster setting must be better for one not to be extended."""
_FALLEN = 0.1
"""Decibels below its best at which a degree counts as too many; two such end the climb."""
_LOST = 3.0
"""Decibels by which something no larger is better where a codec's rate is not lowered further."""
_THINNED, _CODED, _RECKONED = 4, 2, 1
"""How many models near the pareto_front are fitted to fewer lights, of each degree coded, fitted in each precision."""
_SPARED = 0.05
"""Decibels that a codec is not tried for: the front of all settings lies no further from that of those measured."""


def sweep_trade(
    stack: LightStack,
    scene: str,
    out: str | os.PathLike[str],
    axes: Axes,
    *,
    device: Device | None = None,
    progress: Progress | None = None,
    force: bool = False,
    tell: Callable[[str], None] | None = None,
) -> list[Trial]:
    """Measure what is worth measuring, and keep it; rows that `out` holds already are not measured again.

    Methods climb in degree until the PSNR at held-out lights falls twice, each as float32 and as half. Then ``cls`` is
    tried with fewer steps, the best model in other precisions, the models that nothing smaller and faster clearly beats
    with fewer lights, and the best of each degree through the codecs, wherever nothing is known yet that is as good and
    no larger.

    Parameters
    ----------
    stack : LightStack
    scene : str
        The stack's file.
    out : path
        Results file, written whole after every row.
    axes : Axes
    device : Device, optional
    progress : callable, optional
        Called with what is being done, rows done, and rows in all as far as can be told.
    force : bool
        Start anew although `out` exists.
    tell : callable, optional
        Called with what the user should know.

    Raises
    ------
    InputError
        If the stack has too few lights, the device has not a precision that is asked for, or `out` cannot be used, is
        another program's, or holds rows of another stack of this name.
    """
    with claiming(out) as is_claimed:
        if tell is not None and not is_claimed:
            tell(no_locks(out))
        return _Sweep(stack, scene, out, axes, device or open_device(), progress, force).run()


class _Sweep:
    """The trials so far, and the benches that measure them, one for each number of lights."""

    def __init__(
        self,
        stack: LightStack,
        scene: str,
        out: str | os.PathLike[str],
        axes: Axes,
        device: Device,
        progress: Progress | None,
        force: bool,
    ) -> None:
        part, self.scale = excerpt_of(stack, axes.megapixels * 1e6)
        self.stack, self.scene, self.out, self.axes, self.device = in_memory(part), scene, out, axes, device
        self.report = progress or (lambda what, count, total: None)
        n_fit = len(axes.split(stack.directions_i3)[0])
        if n_fit < LEAST_LIGHTS:
            raise InputError(
                f"{stack.name} has {stack.n_light} lights, of which holdout {axes.holdout} leaves {n_fit} to fit: "
                f"a sweep needs {LEAST_LIGHTS}"
            )
        fewer = axes.lights or tuple(n for n in (n_fit // 2, n_fit // 4) if n >= LEAST_LIGHTS)
        if too_many := [n for n in fewer if n > n_fit]:
            raise InputError(f"{too_many[0]} lights cannot be fitted: {n_fit} of {stack.n_light} are not held out")
        self.fewer = sorted({n for n in fewer if n < n_fit}, reverse=True)
        self.survey = survey_stack(self.stack)
        for precision in axes.precisions:
            check_precision(precision, device)
        self.benches: dict[tuple[int | None, str], Bench] = {}
        self.results = earlier_results(out, force)
        self._check_size(out)
        self._bench(None).check_earlier(self.results, out)
        self._bench(None).check_device(self.results, out)
        self.rows = {row_key(row): row for row in self.results.table}
        self.trials: list[Trial] = []
        ladder = sum(map(len, axes.ladders()))
        self.bounds = {  # rows of each step, at most
            "methods and degrees": len(axes.methods) * len(axes.degrees) * (2 if HALF in axes.codecs else 1),
            "solvers": 2 * len(axes.searches()) if "cls" in axes.methods else 0,
            "precision": 2 * (_RECKONED + 1),  # single and double, beside mixed
            "lights": len(self.fewer) * (_THINNED + 1),
            "codecs": ladder * (_CODED * len(axes.degrees) + 1),
        }

    def _check_size(self, out: str | os.PathLike[str]) -> None:
        """Raise InputError if rows of this name were measured on another number of pixels."""
        height, width, _ = self.stack.image_shape
        for row in self._bench(None).own_rows(self.results):
            if (row["height"], row["width"]) != (height, width):
                raise InputError(
                    f"{out} holds rows of {row['width']}×{row['height']} pixels of {self.stack.name!r}, and these "
                    f"are {width}×{height}: other --megapixels, or another stack of this name; choose another --out, "
                    "or start anew with --force"
                )

    def run(self) -> list[Trial]:
        """Take the steps in order: what each looks at are the trials before it, so that going on repeats them."""
        for step, make in (
            ("methods and degrees", self._climb_all),
            ("solvers", self._try_solvers),
            ("precision", self._try_precisions),
            ("lights", self._try_fewer_lights),
            ("codecs", self._try_codecs),
        ):
            begun = len(self.trials)
            later = sum(bound for name, bound in list(self.bounds.items())[list(self.bounds).index(step) + 1 :])
            for model, setting in make():
                done = len(self.trials)
                left = max(self.bounds[step] - (done - begun), 1)
                what = f"{step}: {model.method.title} degree {model.degree}, {storage_label(setting)}"
                self.report(what, done, done + left + later)
                self.trials.append(self._measure(model, setting))
            if all(trial.psnr == -math.inf for trial in self.trials):
                names, degrees = ", ".join(self.axes.methods), ", ".join(map(str, self.axes.degrees))
                raise InputError(f"none of {names} can be fitted to {self.stack.name} at degree {degrees}")
        self.report("done", len(self.trials), len(self.trials))
        return self.trials

    def _bench(self, lights: int | None, precision: str = MIXED) -> Bench:
        key = (lights, precision)
        if key not in self.benches:
            plain = Experiment(
                (self.scene,),
                ("auto",),
                (0,),
                (CodecSetting(),),
                self.axes.holdout,
                lights=lights,
                precision=precision,
                holdout_by=self.axes.holdout_by,
            )
            self.benches[key] = Bench(
                self.stack, plain, self.device, repeats=REPEATS, survey=self.survey, illustrated=False
            )
        return self.benches[key]

    def _measure(self, model: Model, setting: CodecSetting) -> Trial:
        bench = self._bench(model.lights, model.precision)
        identity = bench.identity(model.method, model.degree, setting)
        key = row_key(identity)
        if key not in self.rows:
            self.results = bench.measure(self.results, identity, model.method, model.degree, setting)
            write_results(self.out, self.results)
            self.rows[key] = self.results.table[-1]
        # Of a whole image there is nothing to reckon.
        planned = bench.plan_seconds(model.method, model.degree) if self.scale > 1.0 else 0.0
        return Trial(model, setting, self.rows[key], self.scale, planned)

    def _plain(self) -> list[Trial]:
        return [trial for trial in self.trials if trial.setting.codec is None and trial.model.precision == MIXED]

    def _has_room(self, model: Model) -> bool:
        """Return whether a method that bounds nothing can be fitted to these lights at all sensibly."""
        if model.method.id not in _UNBOUNDED:
            return True
        basis_ik = evaluate_basis(self._bench(model.lights).fit_stack.directions_i3, model.degree)
        svd = decompose(basis_ik)
        return len(svd.singular_r) == coefficient_count(model.degree) and svd.condition <= _MAX_CONDITION

    def _climb_all(self) -> Iterator[tuple[Model, CodecSetting]]:
        storage = [CodecSetting(), *(make_settings(HALF, {}) if HALF in self.axes.codecs else [])]
        for name in self.axes.methods:
            best, falls = -math.inf, 0  # scenes may need a high degree and nothing between: what is idle goes on
            for degree in sorted(self.axes.degrees):
                model = Model(method_class(name)(), degree)
                if falls == 2 or not self._has_room(model):
                    break
                for setting in storage:
                    yield model, setting
                reached = self.trials[-len(storage)].psnr
                falls = falls + 1 if reached < best - _FALLEN else 0
                best = max(best, reached)

    def _try_solvers(self) -> Iterator[tuple[Model, CodecSetting]]:
        by_newton = [trial for trial in self._plain() if trial.model.method.id == "cls"]
        if not by_newton:
            return
        best = max(by_newton, key=lambda trial: trial.psnr).model.degree
        for degree in sorted({best, self._reference().degree}):
            for method in self.axes.searches():
                yield Model(method, degree), CodecSetting()

    def _try_precisions(self) -> Iterator[tuple[Model, CodecSetting]]:
        for model in self._extended(_RECKONED):
            for precision in differing_precisions(model.method, self.device):
                if precision != MIXED and precision in (self.axes.precisions or (precision,)):
                    yield replace(model, precision=precision), CodecSetting()

    def _try_fewer_lights(self) -> Iterator[tuple[Model, CodecSetting]]:
        models = self._extended(_THINNED)
        for lights in self.fewer:
            for model in list(models):
                fewer = replace(model, lights=lights)
                if not self._has_room(fewer):
                    continue
                yield fewer, CodecSetting()
                if self.trials[-1] not in near_pareto_front(self._plain(), _NEAR) and model != self._reference():
                    models.remove(model)

    def _try_codecs(self) -> Iterator[tuple[Model, CodecSetting]]:
        reference, ladders = self._reference(), self.axes.ladders()
        for ladder in ladders:
            for setting in ladder:
                if not self._is_measured(reference, setting):
                    yield reference, setting
                    if self._is_lost(self.trials[-1]):
                        break
        # What is coded is at most about as good as it was: degree by degree, small ones first, each as far as it may
        # still be better than what is no larger.
        settings = sorted((s for ladder in ladders for s in ladder), key=lambda s: s.expected_bits)
        known = [s for s in settings if s.expected_bits < math.inf]
        for best in best_of_degrees(self._usual(), _CODED):
            for setting in known:
                size = setting.expected_bits / 32.0 * best.size
                if best_within(self.trials, size) < best.psnr - _SPARED and not self._is_measured(best.model, setting):
                    yield best.model, setting
        for model in self._extended(_CODED):
            for setting in settings[len(known) :]:
                if not self._is_measured(model, setting):
                    yield model, setting

    def _is_measured(self, model: Model, setting: CodecSetting) -> bool:
        return any((trial.model, trial.setting) == (model, setting) for trial in self.trials)

    def _is_lost(self, trial: Trial) -> bool:
        return any(other.size <= trial.size and other.psnr >= trial.psnr + _LOST for other in self.trials)

    def _extended(self, count: int) -> list[Model]:
        """Return the models that are worth more rows: the best `count` near the pareto_front, and the reference.

        Each with its usual search, or searches that agree would take all the places.
        """
        models = [trial.model for trial in near_pareto_front(self._usual(), _NEAR)[:count]]
        reference = self._reference()
        return models if reference in models else [*models, reference]

    def _usual(self) -> list[Trial]:
        return [t for t in self._plain() if t.model.method == method_class(t.model.method.id)()]

    def _reference(self) -> Model:
        return find_reference(self.trials).model
