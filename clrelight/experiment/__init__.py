"""Experiments: grids of scenes, methods, degrees, codecs and rates, measured row by row."""

from clrelight.experiment.grid import (
    DEFAULT_SCENE,
    CodecSetting,
    Experiment,
    make_methods,
    make_settings,
    paper_experiment,
)
from clrelight.experiment.run import run_experiment
from clrelight.experiment.toml import load_experiment

__all__ = [
    "DEFAULT_SCENE",
    "CodecSetting",
    "Experiment",
    "load_experiment",
    "make_methods",
    "make_settings",
    "paper_experiment",
    "run_experiment",
]
