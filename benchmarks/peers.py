"""The same work in NumPy; see `clrelight.speed.peers`."""

from clrelight.speed.peers import NewtonFit, RootFit, squared_errors

__all__ = ["NewtonFit", "RootFit", "squared_errors"]
