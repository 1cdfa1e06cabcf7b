"""Print quality at equal bytes, and bytes at equal quality, at held-out lights.

    python -m benchmarks.quality_per_byte STACK.h5 ... [--markdown docs/codecs.md] [--picture FILE.png]

Every fifth light is kept out of all fits. Beside ours (`auto` fit, `klt` codec): the paper's constrained least squares
at degree 6 through S3TC and through the same wavelet coder with one step for all maps, and the RTI way (8-bit planes
through JPEG). All bytes are counted, tables included.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.pages import replace_block
from benchmarks.rti_baseline import measure_rti
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table
from clrelight.codec import codec_class, decode_shown, encode
from clrelight.conventions import srgb_to_linear
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import open_device
from clrelight.holdout import split_chosen
from clrelight.jobs.fit import fit
from clrelight.jobs.target import encode_to_quality
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.relight import relight, to_display
from clrelight.store import open_stack

HOLDOUT = 5
BUDGETS = (5_000, 16_600, 40_000, 90_000)
RTI = (("pca27", 100), ("hsh16", 80), ("hsh9", 95), ("ptm", 90))
BEGIN, END = "<!-- bytes -->", "<!-- /bytes -->"
HEADERS = ["stack", "way", "kB", "PSNR (dB)", "klt at these bytes (dB)", "klt at this PSNR (kB)"]


@dataclass(frozen=True)
class Found:
    """One way to store a stack, and what it reaches at the held-out lights."""

    way: str
    byte_count: int
    psnr: float
    coefficients: CoefficientMap | None = None
    curve: str = "linear"


def main() -> None:
    """Measure the stacks named and print the table."""
    print_stacks(__doc__, HEADERS, "|---|---|" + "---:|" * 4, _rows, (BEGIN, END))


def print_stacks(
    about: str | None,
    headers: list[str],
    rule: str,
    rows_of: Callable[[LightStack, str | None], list[list[str]]],
    markers: tuple[str, str],
) -> None:
    """Measure the stacks that the command line names, print a table, and put it and a picture where it says.

    `rule` is the line under the heads in Markdown; `rows_of` is given each stack, and the first where to draw.
    """
    begin, end = markers
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stacks", nargs="+", metavar="STACK.h5")
    parser.add_argument("--markdown", metavar="FILE", help=f"replace what stands between {begin} and {end} there")
    parser.add_argument("--picture", metavar="FILE.png", help="draw the first stack at about equal bytes")
    arguments = parser.parse_args()
    rows: list[list[str]] = []
    with progress_bar("measuring") as bar:
        for index, path in enumerate(arguments.stacks):
            with open_stack(path) as stack:
                rows += rows_of(stack, arguments.picture if index == 0 else None)
            bar(index + 1, len(arguments.stacks))
    print_table(headers, rows)
    if arguments.markdown:
        lines = ["| " + " | ".join(row) + " |" for row in [headers, *rows]]
        replace_block(Path(arguments.markdown), "\n".join([lines[0], rule, *lines[1:]]), begin, end)


def _rows(stack: LightStack, picture: str | None) -> list[list[str]]:
    device = open_device()
    fitted, held = split_chosen(stack.directions_i3, HOLDOUT)
    unseen = stack.select(held)
    ours = fit(stack, "auto", "auto", holdout=HOLDOUT, device=device)
    plain = fit(stack, "cls", 6, holdout=HOLDOUT, device=device)

    def measure(coefficients: CoefficientMap, behind: str = "linear") -> float:
        return summarize_errors(measure_errors(coefficients, unseen, behind=behind, device=device)).psnr_pooled

    def code(way: str, source: CoefficientMap, codec: str, **config: object) -> Found:
        chosen = codec_class(codec).from_config(config).for_transfer(stack.transfer)
        encoded = encode(source.coeffs_khwc, chosen, device, source.basis, source.fitted_lights)
        shown_khwc, curve = decode_shown(encoded.to_bytes(), device)
        shown = replace(source, coeffs_khwc=shown_khwc)
        return Found(way, encoded.encoded_bytes, measure(shown, curve), shown, curve)

    best = measure(ours)
    label = f"{ours.method} degree {ours.degree}, klt"
    mine = [code(label, ours, "klt", byte_budget=budget) for budget in BUDGETS]
    size = plain.coeffs_khwc.size
    # Below some bytes a wavelet's side tables alone are too many: the table starts where they fit.
    others = [
        code("CLS degree 6, wavelet", plain, "wavelet", allocation="global", rate=8.0 * budget / size)
        for budget in BUDGETS
    ]
    others.append(code("CLS degree 6, S3TC", plain, "s3tc"))
    for basis, quality in RTI:
        for found in measure_rti(stack, fitted, held, basis, (quality,)):
            others.append(Found(f"RTI {basis}, JPEG {quality}", found.encoded_bytes, found.psnr_pooled))
    rows = []
    for found in mine:
        rows.append([stack.name, f"**{found.way}**", f"{found.byte_count / 1000:.1f}", f"{found.psnr:.2f}", "", ""])
    for found in others:
        at_bytes = code(label, ours, "klt", byte_budget=found.byte_count)
        beside = "–"
        if found.psnr < best:
            encoded, _, _ = encode_to_quality(ours, unseen, found.psnr, device=device)
            beside = f"{encoded.encoded_bytes / 1000:.1f}"
        rows.append(
            [
                stack.name,
                found.way,
                f"{found.byte_count / 1000:.1f}",
                f"{found.psnr:.2f}",
                f"{at_bytes.psnr:.2f}",
                beside,
            ]
        )
    rows.append([stack.name, f"{ours.method} degree {ours.degree}, float32", "", f"{best:.2f}", "", ""])
    if picture is not None:
        draw_ways(picture, stack, int(held[len(held) // 2]), [mine[1], others[1], others[len(BUDGETS)]])
    return rows


def draw_ways(path: str, stack: LightStack, light: int, ways: list[Found]) -> None:
    """Draw one held-out photograph beside its relit images."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width, _ = stack.image_shape
    photograph = stack.read_rows(0, height)[light] / stack.peak
    panels = [("photograph, not fitted", to_display(photograph, "linear"))]
    for found in ways:
        if found.coefficients is not None:
            image = relight(found.coefficients, stack.directions_i3[light : light + 1])[0]
            image = srgb_to_linear(image) if found.curve == "srgb" else image
            panels.append(
                (
                    f"{found.way}\n{found.byte_count / 1000:.1f} kB, {found.psnr:.1f} dB",
                    to_display(image, stack.transfer),
                )
            )
    figure = Figure(figsize=(2.6 * len(panels), 2.6 * height / width + 0.7), dpi=120)
    FigureCanvasAgg(figure)
    for place, (title, image) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), place + 1)
        axes.imshow(np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image, interpolation="nearest")
        axes.set_title(title, fontsize=8)
        axes.axis("off")
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})


if __name__ == "__main__":
    main()
