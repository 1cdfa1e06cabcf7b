"""Stages and their rows; see `clrelight.speed.stage`."""

from clrelight.speed.stage import Row, Stage, measure

__all__ = ["Row", "Stage", "measure"]
