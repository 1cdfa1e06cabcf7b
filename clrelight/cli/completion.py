"""``clrelight completion``: names of commands and options at the tabulator key."""

from __future__ import annotations

import os

import click
from click.shell_completion import get_completion_class, shell_complete


def known_methods(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Return the methods of fit, and auto, that begin so."""
    from clrelight.fit import method_ids

    return [name for name in ("auto", *method_ids()) if name.startswith(incomplete)]


def known_codecs(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Return the codecs that begin so."""
    from clrelight.codec import codec_ids

    return [name for name in codec_ids() if name.startswith(incomplete)]


SHELLS = ("bash", "zsh", "fish")
VARIABLE = "_CLRELIGHT_COMPLETE"
"""What the script of a shell sets when it asks for completions."""


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script with which a shell completes commands, options, their choices and file names.

    \b
    Example:
      clrelight completion fish > ~/.config/fish/completions/clrelight.fish
      eval "$(clrelight completion bash)"              # in ~/.bashrc
      eval "$(clrelight completion zsh)"               # in ~/.zshrc
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "clrelight", VARIABLE).source())


def answer_shell(command: click.Command) -> int | None:
    """Answer a shell that asks for completions, and return the exit code; None where none asks."""
    asked = os.environ.get(VARIABLE)
    return shell_complete(command, {}, "clrelight", VARIABLE, asked) if asked else None


COMMANDS = (completion,)
