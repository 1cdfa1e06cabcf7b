"""The group of commands, and how errors reach the user: one line, exit code 2."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress

import click

from clrelight import __version__
from clrelight.cli import (
    batch,
    coding,
    completion,
    experiments,
    export,
    files,
    find_lights,
    fit,
    irradiance,
    light,
    machines,
    normals,
    operators,
    pack,
    plan_lights,
    preview,
    psnr,
    reflectance,
    reflection,
    relight,
    render,
    reproduce,
    sampled,
    shader,
    to_sh,
    trade,
    transfer,
    variation,
    view,
)
from clrelight.cli.quiet import add_quiet, asked_output, speaking_after
from clrelight.cli.sections import Sectioned
from clrelight.errors import InputError, KernelBuildError
from clrelight.interrupts import end_watch, watch_interrupts

# Of click 8.2; before, a group without a command printed its help and raised Exit.
_NO_COMMAND = getattr(click.exceptions, "NoArgsIsHelpError", ())


@click.group(cls=Sectioned, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, message="clrelight %(version)s")
def cli() -> None:
    """Fit, compress, relight and measure image stacks of one view under many lights.

    \b
    From photographs to a file, and an image of it:
      clrelight pack photos/ view.h5 --lights lights.lp --transfer srgb
      clrelight relight view.h5 relit.png --light 0.3,0.1,2

    \b
    From photographs to a table:
      clrelight ingest photos/ stack.h5 --lights lights.lp
      clrelight bench stack.h5 --out results.h5
      clrelight report results.h5 --out report/
    """


for module in (
    *(machines, pack, files, plan_lights, fit, coding, relight, render, shader, export),
    *(light, sampled, irradiance, reflection, reflectance, psnr, experiments, trade),
    *(operators, transfer, normals, variation, find_lights, to_sh, view, preview, batch, completion, reproduce),
):
    for command in module.COMMANDS:
        cli.add_command(command)
add_quiet(cli)


def run(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit code; what is no user's fault goes on as the exception that it is."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with watch_interrupts(), speaking_after():
            return _say(*_run(words))
    except KeyboardInterrupt:
        ending = end_watch()
        if ending is None:
            raise
        return _say(*ending)


def _run(words: list[str]) -> tuple[int, str]:
    """Run a command; return its exit code and what is to be said of it."""
    try:
        if (answered := completion.answer_shell(cli)) is not None:
            return answered, ""
        # Not cli.main, which ends the program by itself at a broken pipe.
        with cli.make_context("clrelight", words) as context:
            cli.invoke(context)
        asked_output().flush()
        return 0, ""
    except BaseException as error:
        # What comes after a signal comes of it, whatever it says: an import cut short, say.
        ending = end_watch() or _explain(error, words)
        if ending is None:
            raise
        return ending
    finally:
        end_watch()


def _say(code: int, message: str) -> int:
    if message:
        with suppress(OSError, ValueError):  # nobody may be there to read it
            print(message, file=sys.stderr)
    return code


def _explain(error: BaseException, words: list[str]) -> tuple[int, str] | None:
    """Return the exit code and the line to print of an error; None where it is our fault."""
    if isinstance(error, click.exceptions.Exit):
        return error.exit_code, ""
    if isinstance(error, click.UsageError):
        if error.ctx and isinstance(error, _NO_COMMAND):
            click.echo(error.ctx.get_help())
            return 0, ""
        return _refuse(_usage_line(error, words))
    if isinstance(error, BrokenPipeError):
        return 0, ""  # the reader of a pipe has gone: nothing is left to say, and nobody to say it to
    if _lacks_descriptors(error):
        return _refuse("clrelight: too few files may be open at once (ulimit -n): allow more, such as ulimit -n 256")
    if isinstance(error, click.ClickException):
        return _refuse(f"clrelight: {error.format_message()}")
    if isinstance(error, click.Abort | KeyboardInterrupt):  # without a signal: somebody else's
        return _refuse("clrelight: interrupted; files that were not finished are discarded", 130)
    if isinstance(error, InputError):
        return _refuse(f"clrelight: {error}")
    if isinstance(error, OSError):
        place = f"{os.fsdecode(error.filename)}: " if error.filename else ""
        return _refuse(f"clrelight: {place}{error.strerror or error}")
    if isinstance(error, MemoryError):
        return _refuse(f"clrelight: out of memory ({error}); ask for less at once (--memory, --size, --degree)")
    if isinstance(error, KernelBuildError):
        return 1, f"clrelight: {error}"
    return None


def _usage_line(error: click.UsageError, words: list[str]) -> str:
    """Return what is wrong with a command's words, and what words it takes where some are missing or too many."""
    told = error.format_message().rstrip(".")
    if error.ctx is None:  # an option without its value: the parser knows no command
        where = _path_of(words)
        return f"{where}: {told} (see {where} --help)"
    where, command = error.ctx.command_path, error.ctx.command
    if isinstance(command, click.Group):
        if "Did you mean" not in told and not isinstance(command, Sectioned):
            told = f"{told}; there are {', '.join(command.list_commands(error.ctx))}"
    elif "argument" in told:
        told = f"{told}; it is {where} {' '.join(command.collect_usage_pieces(error.ctx))}"
    return f"{where}: {told} (see {where} --help)"


def _path_of(words: list[str]) -> str:
    """Return the command that words are of, as its help names it."""
    path = ["clrelight"]
    group: click.Group = cli
    for word in words:
        command = group.commands.get(word)
        if command is None:
            break
        path.append(word)
        if not isinstance(command, click.Group):
            break
        group = command
    return " ".join(path)


def _refuse(message: str, code: int = 2) -> tuple[int, str]:
    return code, " ".join(message.split())


def _lacks_descriptors(error: BaseException | None) -> bool:
    """Return whether the system refused to open one file more, whatever a library made of that."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            return True
        if "Too many open files" in str(error):  # a module that cannot be loaded, or HDF5
            return True
        error = error.__cause__ or error.__context__
    return False
