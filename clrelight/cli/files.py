"""``clrelight ingest``, ``synth`` and ``info``: making stacks and looking at files."""

from __future__ import annotations

import time
from typing import Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.options import (
    Command,
    Numbers,
    clip_negative_option,
    json_option,
    layer_option,
    memory_option,
    whole_number,
)
from clrelight.cli.output import print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.sections import Whole
from clrelight.errors import InputError
from datasets_synth.scenes import SCENES, Option, Scene

_READING = (
    click.option(
        "--lights", type=click.Path(), metavar="FILE", help="Light directions: .lp, a table N×3 or 3×N, or DiLiGenT."
    ),
    click.option(
        "--transfer",
        type=click.Choice(["linear", "srgb"]),
        help="Curve of the values; default: linear.",
    ),
    click.option("--peak", type=float, help="Code value that means 1.0; default: the largest integer, 1.0 for floats."),
    click.option(
        "--crop", type=Numbers(int, "X,Y,W,H", 4), help="Part of the images to keep, in pixels from the top left."
    ),
    click.option(
        "--mask", type=click.Path(), help="Image that is not zero where pixels count, or its alpha where flat."
    ),
    click.option(
        "--downscale", type=whole_number(2), metavar="N", help="Average N×N pixels in radiance: 2 is half the size."
    ),
    click.option(
        "--max-side", type=whole_number(1), metavar="PX", help="Average so that the longer side has so many pixels."
    ),
    layer_option,
    click.option(
        "--upright", is_flag=True, help="Turn images as their EXIF orientation says; default: as they are stored."
    ),
    clip_negative_option,
    click.option("--subset", metavar="LIGHTS", help="Lights to take: a slice such as 0:200:2, or 0,5,7."),
    click.option("--allow-below", is_flag=True, help="Accept lights below the horizon and fit over what is there."),
    click.option("--name", help="What tables call the stack; default: the folder's name."),
)


def reading_options(command: Command) -> Command:
    """Add the options of reading a folder of photographs."""
    for option in reversed(_READING):
        command = option(command)
    return command


@click.command()
@click.argument("folder", type=click.Path())
@click.argument("out", type=click.Path())
@reading_options
@memory_option("1GiB", "image data in memory")
@json_option
def ingest(folder: str, out: str, memory: int, as_json: bool, **options: Any) -> None:
    """Read a folder of photographs under known lights into one stack file.

    The lights come from --lights, or from what lies in the folder: DiLiGenT's text files, one .lp file, or
    light_directions.txt. Images keep their depth (8 or 16 bit, half, float).

    \b
    Example:
      clrelight ingest photos/ stack.h5 --lights photos/dome.lp --transfer srgb
    """
    from clrelight.jobs.ingest import ingest as run_ingest
    from clrelight.jobs.report import Report

    report = Report()
    with progress_bar("reading images") as bar:
        run_ingest(folder, out, memory=memory, progress=bar, report=report, **options)
    if as_json:
        print_json(report.to_json())
        return
    print_notes(report.notes)
    facts = report.facts
    height, width, channel = facts["image_shape"]
    low, high = facts["elevation_range"]
    print_facts(
        {
            "stack": out,
            "images": f"{facts['n_light']} of {width}×{height}, {channel} channel(s), {facts['dtype']}",
            "values": f"{facts['transfer']}, {facts['peak']:g} means 1.0",
            "elevation": f"{low:.1f}° to {high:.1f}°",
            "duplicates": facts["duplicates"],
        }
    )


@click.group(cls=Whole)
def synth() -> None:
    """Render a test scene into a stack file."""


def _synth_command(scene: Scene) -> click.Command:
    """Return the command that renders a scene."""

    def render(out: str, as_json: bool, **options: Any) -> None:
        from clrelight.store import write_stack

        claim_output(out)
        since = time.perf_counter()
        with progress_bar("rendering") as bar:
            stack = scene.render(options, bar)
        seconds = {"render": time.perf_counter() - since}
        since = time.perf_counter()
        write_stack(out, stack)
        seconds["write"] = time.perf_counter() - since
        facts = {"file": out, "lights": stack.n_light, **options}
        if as_json:
            print_json({**facts, "seconds": seconds})
        else:
            print_facts({**facts, "time": seconds_line(seconds)})

    parameters = [
        click.Option([f"--{o.name}"], type=_type_of(o), default=o.default, show_default=True, help=o.help)
        for o in scene.options
    ]
    example = f"\b\nExample:\n  clrelight synth {scene.name} {scene.name}.h5 {scene.example}"
    command = click.Command(
        scene.name,
        callback=render,
        params=[click.Argument(["out"], type=click.Path()), *parameters],
        help=f"{scene.summary}\n\n{example}",
    )
    return json_option(command)


def _type_of(option: Option) -> click.ParamType:
    return click.Choice(option.choices) if option.choices else whole_number(option.least, option.most)


for _scene in SCENES.values():
    synth.add_command(_synth_command(_scene))


@click.command()
@click.argument("file", type=click.Path())
@click.option("--no-thumbnail", is_flag=True, help="Print text alone, also on a terminal that shows pictures.")
@json_option
def info(file: str, no_thumbnail: bool, as_json: bool) -> None:
    """Say what a file of ours holds, or one of other viewers: .ptm, .rti, a folder of relight, a list of lights.

    A terminal that can shows a small picture too: kitty, iTerm2 and those with sixels, or any of 24-bit colours.

    \b
    Example:
      clrelight info stack.h5
      clrelight info old.ptm
      clrelight info dome.lp
    """
    from clrelight.cli.terminal import picture_form
    from clrelight.jobs.foreign import describe_foreign
    from clrelight.store import describe

    foreign = describe_foreign(file)
    facts = describe(file) if foreign is None else foreign
    if as_json:
        print_json(facts)
        return
    form = None if no_thumbnail or "fetched" in facts else picture_form()
    if form is not None:
        _print_thumbnail(file, form)
    print_notes(facts.pop("notes", []))
    print_facts(facts if foreign is None else _foreign_lines(facts))


def _foreign_lines(facts: dict[str, Any]) -> dict[str, Any]:
    """Return facts of another program's file as people read them: names of images shortened."""
    lines = dict(facts)
    if "elevation_range" in lines:
        low, high = lines.pop("elevation_range")
        lines["elevation"] = f"{low:.1f}° to {high:.1f}°"
    if names := lines.pop("images", []):
        lines["images"] = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
    return lines


def _print_thumbnail(file: str, form: str) -> None:
    """Print a picture; where there is none for a reason, a note."""
    from clrelight.cli.terminal import longest_side, picture_text
    from clrelight.jobs.thumbnail import thumbnail

    try:
        picture = thumbnail(file, longest_side(form))
    except InputError as error:  # the file was found sound: it may want a device
        print_notes([f"no thumbnail: {error}"])
        return
    if picture is not None:
        click.echo(picture_text(picture, form), nl=False, color=True)


COMMANDS = (ingest, synth, info)
