"""The same work in NumPy; see `clrelight.speed.peers`."""

from clrelight.speed.peers import NewtonFit, squared_errors

__all__ = ["NewtonFit", "squared_errors"]
