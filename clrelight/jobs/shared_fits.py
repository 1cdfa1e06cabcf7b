"""A fit that one process has prepared, for others: its matrices as a file, and the same fit from it again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.fit import PreparedFit, method_class
from clrelight.fit.plan import make_lighting
from clrelight.fit.prepare import FitReport
from clrelight.jobs.farm import Farm, facts_of, read_arrays, text_array


def share_fit(farm: Farm, prepared: PreparedFit, lights: NDArray[np.intp]) -> str:
    """Return a file of a fit of some lights of a stack."""
    plan = prepared.plan
    facts = {
        "method": prepared.method.id,
        "options": prepared.method.to_config(),
        "degree": prepared.degree,
        "precision": prepared.precision,
        "config": dict(prepared.config),
        "condition": plan.condition,
    }
    arrays: dict[str, NDArray] = {
        "facts": text_array(facts),
        "lights": np.asarray(lights, np.int64),
        "analysis_ri": plan.analysis_ri,
        "singular_r": plan.singular_r,
        "energy_i": plan.energy_i,
    }
    if plan.synthesis_kr is not None:
        arrays["synthesis_kr"] = plan.synthesis_kr
    return farm.share("plan", arrays)


def shared_fit(stack: LightStack, plan: str, device: Device) -> PreparedFit:
    """Return the fit that another process has prepared, with its very matrices: other processors may find others."""
    arrays = read_arrays(plan)
    facts = facts_of(arrays["facts"])
    lights, config = arrays["lights"], facts["config"]
    chosen = stack if len(lights) == stack.n_light else stack.select(lights)
    method = method_class(facts["method"]).from_config(facts["options"])
    lighting = make_lighting(chosen, config["weights"], config["sampling"], config.get("basis", SH))
    made = replace(
        method.plan(lighting, facts["degree"]),
        analysis_ri=arrays["analysis_ri"],
        synthesis_kr=arrays.get("synthesis_kr"),
        singular_r=arrays["singular_r"],
        energy_i=arrays["energy_i"],
        condition=facts["condition"],
    )
    return PreparedFit(chosen, method, facts["degree"], config, made, device, FitReport(), precision=facts["precision"])
