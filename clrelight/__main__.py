"""``python -m clrelight``."""

from clrelight.cli import main

if __name__ == "__main__":
    main()
