"""Rows as text; see `clrelight.speed.tables`."""

from clrelight.speed.tables import (
    EXPENDABLE,
    HEADERS,
    cells,
    check_markdown,
    replace_block,
    to_json,
    to_markdown,
)

__all__ = ["EXPENDABLE", "HEADERS", "cells", "check_markdown", "replace_block", "to_json", "to_markdown"]
