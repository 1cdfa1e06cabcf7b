"""Rewrite the tables and charts of docs/trade.md: what each choice costs on three stacks.

    python -m benchmarks.trade_page [--data FOLDER] [--folder results/trade]

The ring scene is rendered; the photographs are read from FOLDER (default: $CLRELIGHT_DATA), and their blocks are left
as they are, with a message, where there is none. Rows measured before in `--folder` are taken from there; remove it to
measure anew.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.pages import check_markdown, replace_block
from clrelight.cli.progress import progress_bar
from clrelight.device import open_device
from clrelight.experiment.axes import Axes
from clrelight.experiment.pareto import Trial
from clrelight.experiment.trade import sweep_trade
from clrelight.ingest import ingest_folder
from clrelight.report import canvas
from clrelight.report.markup import to_markdown
from clrelight.report.trade import step_table, trade_chart
from clrelight.store import open_stack, write_stack
from datasets_synth.ring import render_ring

PAGE = Path("docs/trade.md")
PICTURES = Path("docs/images")
AXES = Axes(
    methods=("uls", "cls", "ceb", "spline"),
    degrees=(2, 4, 6, 8),
    codecs=("half", "klt", "s3tc"),
    rates=(1.0, 0.25, 0.1),
)


@dataclass(frozen=True)
class Scene:
    """A stack of the page: its name, what it needs of the data folder ("" for nothing), and how it is made."""

    name: str
    source: str
    make: Callable[[Path, Path], object]


def _make_ring(source: Path, out: Path) -> None:
    write_stack(out, render_ring(size=128, lights=128))


def _make_lion(source: Path, out: Path) -> None:
    ingest_folder(source / "jpg", out, lights=source / "dirs.lp", transfer="srgb", name="loewenkopf")


def _make_cat(source: Path, out: Path) -> None:
    ingest_folder(source, out, crop=(100, 110, 96, 96), name="cat")


SCENES = (
    Scene("ring", "", _make_ring),
    Scene("loewenkopf", "stacks/loewenkopf", _make_lion),
    Scene("cat", "stacks/diligent/catPNG", _make_cat),
)


def main() -> None:
    """Measure the scenes that can be, and rewrite their blocks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("CLRELIGHT_DATA"))
    parser.add_argument("--folder", type=Path, default=Path("results/trade"))
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for scene in SCENES:
        check_markdown(PAGE, *_markers(scene))
    for scene in SCENES:
        source = (arguments.data or Path()) / scene.source
        if scene.source and (arguments.data is None or not source.is_dir()):
            print(f"{scene.name} is left as it is: there is no folder {source} (set CLRELIGHT_DATA)")
            continue
        path = arguments.folder / f"{scene.name}.h5"
        if not path.exists():
            scene.make(source, path)
        replace_block(PAGE, _block(scene, _sweep(scene, path)), *_markers(scene))


def _markers(scene: Scene) -> tuple[str, str]:
    return f"<!-- {scene.name} -->", f"<!-- /{scene.name} -->"


def _sweep(scene: Scene, path: Path) -> list[Trial]:
    with open_stack(path) as stack, progress_bar(scene.name) as bar:
        return sweep_trade(
            stack,
            str(path),
            path.with_name(f"{scene.name}_trade.h5"),
            AXES,
            progress=lambda step, done, total: bar(done, total, step),
        )


def _block(scene: Scene, trials: list[Trial]) -> str:
    row = trials[0].row
    with canvas.house_style():
        canvas.save(trade_chart(trials, scene.name), PICTURES / f"trade_{scene.name}.png")
    facts = (
        f"{row['width']}×{row['height']} pixels, {row['n_light']} lights fitted and {row['n_holdout']} held out; "
        f"{len(trials)} settings measured on {open_device().info.name}."
    )
    table = step_table(trials)
    chart = f"![fronts of {scene.name}](images/trade_{scene.name}.png)"
    return "\n".join([facts, "", chart, "", f"{table.caption}:\n\n{to_markdown(table)}"])


if __name__ == "__main__":
    main()
