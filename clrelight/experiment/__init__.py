"""Experiments: grids of scenes, methods, degrees, codecs and rates, measured row by row."""

from clrelight.experiment.grid import RING, CodecSetting, Experiment, make_methods, make_settings, paper_experiment
from clrelight.experiment.run import run_experiment
from clrelight.experiment.toml import load_experiment

__all__ = [
    "RING",
    "CodecSetting",
    "Experiment",
    "load_experiment",
    "make_methods",
    "make_settings",
    "paper_experiment",
    "run_experiment",
]
