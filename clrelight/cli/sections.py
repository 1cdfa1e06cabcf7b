"""The list of commands in the order of what people want, where an alphabet would hide the first behind the last."""

from __future__ import annotations

import click

SECTIONS = {
    "Photographs to one file, and pictures of it": ("pack", "relight", "view", "unpack", "preview", "info"),
    "The same step by step, and measured": ("ingest", "fit", "encode", "decode", "psnr", "find-lights", "plan-lights"),
    "What photographs tell besides": ("normals", "variation"),
    "Light": ("light", "project", "product", "irradiance", "shrm", "brdf"),
    "Surfaces": ("transfer", "operators", "render", "reflect", "shader"),
    "For other programs, and from them": ("export", "import", "to-sh"),
    "Comparisons": ("bench", "report", "trade", "synth", "reproduce"),
    "Many stacks, and this machine": ("batch", "devices", "selftest", "completion"),
}
"""Which commands stand under which heading; any other stands under the last one, `OTHERS`."""
OTHERS = "Others"

_WHOLE = 1000


class Whole(click.Group):
    """A group whose help lists its commands each with its whole first sentence."""

    def sections(self, ctx: click.Context) -> dict[str, tuple[str, ...]]:
        """Return the commands by heading."""
        return {"Commands": tuple(self.list_commands(ctx))}

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list; see `click.Group`."""
        for title, names in self.sections(ctx).items():
            rows = [
                (name, self.commands[name].get_short_help_str(_WHOLE))
                for name in names
                if name in self.commands and not self.commands[name].hidden
            ]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


class Sectioned(Whole):
    """Such a group, whose commands stand under `SECTIONS`."""

    def sections(self, ctx: click.Context) -> dict[str, tuple[str, ...]]:
        """Return the commands by heading."""
        told = {name for names in SECTIONS.values() for name in names}
        return {**SECTIONS, OTHERS: tuple(name for name in self.list_commands(ctx) if name not in told)}
