"""What a command is about to write belongs to it alone, from before the work until its end."""

from __future__ import annotations

import os
from collections.abc import Iterable

import click

from clrelight.cli.output import print_notes


def claim_output(path: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]] = ()) -> None:
    """Check an output as `check_output` does, and keep every other program from it until the command ends."""
    from clrelight.durable import claiming, no_locks
    from clrelight.store import check_output

    check_output(path, inputs)
    if not click.get_current_context().with_resource(claiming(path)):
        print_notes([no_locks(path)])
