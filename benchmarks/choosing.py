"""What choosing costs beside the fit: ``python -m benchmarks.choosing [--markdown docs/performance.md]``.

Processor time (user and system) of what `fit --method auto --degree auto` does: choosing, the fit that was chosen,
and measuring it at all its photographs. The ring in 8 bits, its pixels repeated to each size. Kernels are built before,
and the least of the rounds counts, so that a busy machine shows little in it.
"""

from __future__ import annotations

import argparse
import resource
import warnings
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from benchmarks.pages import replace_block
from clrelight.dataset import LightStack
from clrelight.device import Device, open_device
from clrelight.fit import PreparedFit, collect_fit, prepare_fit
from clrelight.fit.run import fit_tiles
from clrelight.metrics import measure_errors
from clrelight.speed.environment import describe_environment
from datasets_synth.ring import render_ring

BEGIN, END = "<!-- choosing -->", "<!-- /choosing -->"
CASES = ((176, 176, 60), (512, 1024, 60), (1024, 1024, 60), (2048, 2048, 60), (64, 64, 1790))
"""Height, width and lights."""
HEADERS = (
    "pixels",
    "lights",
    "`auto` took",
    "choosing, s",
    "fit, s",
    "choosing / fit",
    "measuring, s",
    "measuring / fit",
)
_RENDERED = 176
_MEASURED_PIXELS = 1 << 18
"""A fit of more is measured on rows of about so many, and the figure scaled: its map would fill the memory."""


def spent() -> float:
    """Return the processor seconds of this process so far."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def make_case(height: int, width: int, lights: int) -> LightStack:
    """Return the ring under so many lights, cut or repeated to a size."""
    ring = render_ring(size=min(_RENDERED, height), lights=lights)
    repeats = (1, -(-height // ring.image_shape[0]), -(-width // ring.image_shape[1]), 1)
    images_ihwc = np.tile(ring.images_ihwc, repeats)[:, :height, :width]
    return LightStack(np.ascontiguousarray(images_ihwc), ring.directions_i3, ring.peak)


def time_once(stack: LightStack, device: Device) -> tuple[PreparedFit, float, float, float]:
    """Return the fit that was chosen, and the processor seconds of choosing, fitting and measuring."""
    since = spent()
    chosen = prepare_fit(stack, "auto", "auto", device=device)
    choosing, since = spent() - since, spent()
    # The choice in it: what is left is making matrices anew, which a fit without a choice does too.
    prepared = prepare_fit(stack, chosen.method, chosen.degree, device=device)
    with closing(fit_tiles(prepared)) as tiles:
        for _ in tiles:
            pass
    fitting = spent() - since
    rows = max(1, min(stack.image_shape[0], _MEASURED_PIXELS // stack.image_shape[1]))
    part = LightStack(np.ascontiguousarray(stack.images_ihwc[:, :rows]), stack.directions_i3, stack.peak)
    fitted = collect_fit(prepare_fit(part, chosen.method, chosen.degree, device=device))
    since = spent()
    measure_errors(fitted, part, device=device)
    return chosen, choosing, fitting, (spent() - since) * stack.image_shape[0] / rows


def time_case(case: tuple[int, int, int], device: Device, rounds: int) -> list[str]:
    """Return a row of the table."""
    stack = make_case(*case)
    timed = [time_once(stack, device) for _ in range(rounds)]
    choosing, fitting, measuring = (min(one[k] for one in timed) for k in (1, 2, 3))
    took = f"{timed[0][0].method.id} {timed[0][0].degree}"
    pixels = f"{case[0]} × {case[1]}"
    figures = [f"{choosing:.2f}", f"{fitting:.2f}", f"{choosing / fitting:.2f}"]
    return [pixels, str(case[2]), took, *figures, f"{measuring:.2f}", f"{measuring / fitting:.2f}"]


def make_table(rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(HEADERS) + " |", "|---" * len(HEADERS) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def main() -> None:
    """Print the table, and fill a page with it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=len(CASES), help="The first so many of the sizes.")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--markdown", type=Path, help=f"Fill what stands between {BEGIN} and {END}.")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    device = open_device(None)
    time_once(make_case(16, 16, 60), device)
    rows = []
    for case in CASES[: given.cases]:
        rows.append(time_case(case, device, given.rounds))
        print(" | ".join(rows[-1]), flush=True)
    facts = describe_environment(device)
    table = (
        "\n".join(f"- {name}: {facts[name]}" for name in ("commit", "machine", "device")) + "\n\n" + make_table(rows)
    )
    print(table)
    if given.markdown is not None:
        replace_block(given.markdown, table, BEGIN, END)


if __name__ == "__main__":
    main()
