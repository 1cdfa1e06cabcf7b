"""The group of commands, and how errors reach the user: one line, exit code 2."""

from __future__ import annotations

import os
import sys

import click

from clrelight import __version__
from clrelight.cli import (
    coding,
    experiments,
    export,
    files,
    fitting,
    images,
    light_plans,
    lighting,
    machines,
    quality,
    trade,
)
from clrelight.cli.interrupts import watch_interrupts
from clrelight.errors import InputError, KernelBuildError

INTERRUPTED = 130

# Of click 8.2; before, a group without a command printed its help and raised Exit.
_NO_COMMAND = getattr(click.exceptions, "NoArgsIsHelpError", ())


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


for module in (machines, files, light_plans, fitting, coding, images, export, lighting, quality, experiments, trade):
    for command in module.COMMANDS:
        cli.add_command(command)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 our fault, 2 bad input, 130 interrupted."""
    sys.exit(run(arguments))


def run(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit code; what is no user's fault goes on as the exception that it is."""
    try:
        # Not cli.main, which ends the program by itself at a broken pipe.
        words = list(sys.argv[1:] if arguments is None else arguments)
        with watch_interrupts(), cli.make_context("clrelight", words) as context:
            cli.invoke(context)
        sys.stdout.flush()
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.UsageError as error:
        if error.ctx and isinstance(error, _NO_COMMAND):
            click.echo(error.ctx.get_help())
            return 0
        where = error.ctx.command_path if error.ctx else "clrelight"
        return _fail(f"{where}: {error.format_message().rstrip('.')} (see {where} --help)")
    except click.ClickException as error:
        return _fail(f"clrelight: {error.format_message()}")
    except (click.Abort, KeyboardInterrupt):
        return _fail("clrelight: interrupted; files that were not finished are discarded", INTERRUPTED)
    except InputError as error:
        return _fail(f"clrelight: {error}")
    except BrokenPipeError:
        return _leave_pipe()
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _fail(f"clrelight: {place}{error.strerror or error}")
    except MemoryError as error:
        return _fail(f"clrelight: out of memory ({error}); ask for less at once (--memory, --size, --degree)")
    except KernelBuildError as error:
        return _fail(f"clrelight: {error}", 1)
    return 0


def _leave_pipe() -> int:
    """The reader of a pipe has gone: nothing is left to say, and nobody to say it to."""
    # What is still buffered would be tried again at the interpreter's end, and complained about.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _fail(message: str, code: int = 2) -> int:
    text = message if code == 1 else " ".join(message.split())
    print(text, file=sys.stderr)
    return code
