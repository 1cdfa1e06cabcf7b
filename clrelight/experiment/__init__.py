"""Experiments: grids of scenes, methods, degrees, codecs and rates, measured row by row."""

from clrelight.experiment.grid import RING, CodecSetting, Experiment, load_experiment, make_settings, paper_experiment
from clrelight.experiment.run import run_experiment

__all__ = [
    "RING",
    "CodecSetting",
    "Experiment",
    "load_experiment",
    "make_settings",
    "paper_experiment",
    "run_experiment",
]
