"""The group of commands, and how errors reach the user: one line, exit code 2."""

from __future__ import annotations

import sys

import click

from clrelight import __version__
from clrelight.cli import experiments, files, fitting, images, machines
from clrelight.errors import InputError, KernelBuildError

INTERRUPTED = 130


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, message="clrelight %(version)s")
def cli() -> None:
    """Fit, compress, relight and measure image stacks of one view under many lights.

    \b
    From photographs to a table:
      clrelight ingest photos/ stack.h5 --lights lights.lp
      clrelight bench stack.h5 --out results.h5
      clrelight report results.h5 --out report/
    """


for module in (machines, files, fitting, images, experiments):
    for command in module.COMMANDS:
        cli.add_command(command)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 our fault, 2 bad input, 130 interrupted."""
    sys.exit(run(arguments))


def run(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    try:
        cli.main(arguments, prog_name="clrelight", standalone_mode=False)
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "clrelight"
        return _fail(f"{where}: {error.format_message()} (see {where} --help)")
    except click.ClickException as error:
        return _fail(f"clrelight: {error.format_message()}")
    except (click.Abort, KeyboardInterrupt):
        return _fail("clrelight: interrupted; what was being written is discarded, older files are as they were", 130)
    except InputError as error:
        return _fail(f"clrelight: {error}")
    except BrokenPipeError:
        # The reader of a pipe has gone: nothing is left to say, and nobody to say it to.
        sys.stderr.close()
        return 0
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _fail(f"clrelight: {place}{error.strerror or error}")
    except MemoryError as error:
        return _fail(f"clrelight: out of memory ({error}); try a smaller --memory")
    except KernelBuildError as error:
        return _fail(f"clrelight: {error}", 1)
    return 0


def _fail(message: str, code: int = 2) -> int:
    text = message if code == 1 else " ".join(message.split())
    print(text, file=sys.stderr)
    return code
