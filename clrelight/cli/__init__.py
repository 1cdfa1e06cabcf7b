"""The command line. Command modules import what is heavy inside their functions, so that ``--help`` is quick."""

from clrelight.cli.app import main

__all__ = ["main"]
