"""``python -m clrelight``."""

from clrelight.cli import main

main()
