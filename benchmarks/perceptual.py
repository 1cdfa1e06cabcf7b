"""Print what ``--metric perceptual`` of klt changes: PSNR, FLIP and CIEDE2000 at held-out lights.

    python -m benchmarks.perceptual STACK.h5 ... [--markdown docs/codecs.md] [--picture FILE.png]

Every fifth light is kept out. Standard errors are those of the lights that FLIP and CIEDE2000 are measured at; they are
the same for both metrics, so that differences between metrics are far more certain than the figures themselves.
"""

from __future__ import annotations

from dataclasses import replace

from benchmarks.quality_per_byte import HOLDOUT, Found, draw_ways, print_stacks
from clrelight.codec import decode_shown
from clrelight.codec.transforms.colour import METRICS
from clrelight.dataset import LightStack
from clrelight.device import open_device
from clrelight.holdout import split_chosen
from clrelight.jobs.encode import encode
from clrelight.jobs.fit import fit
from clrelight.jobs.measure import measure

RATES = (0.005, 0.02, 0.05)
METHOD, DEGREE = "spectrum", 9
BEGIN, END = "<!-- perceptual -->", "<!-- /perceptual -->"
HEADERS = ["stack", "bit", "metric", "kB", "PSNR (dB)", "FLIP", "CIEDE2000"]


def main() -> None:
    """Measure the stacks named and print the table."""
    print_stacks(__doc__, HEADERS, "|---|---:|---|" + "---:|" * 4, _rows, (BEGIN, END))


def _rows(stack: LightStack, picture: str | None) -> list[list[str]]:
    device = open_device()
    fitted = fit(stack, METHOD, DEGREE, holdout=HOLDOUT, device=device)
    rows, drawn = [], []
    for rate in RATES:
        for metric in METRICS:
            encoded = encode(fitted, "klt", rate=rate, metric=metric, device=device)
            found = measure(encoded, stack, perceptual=True, device=device)
            seen = [
                f"{found[f'{name}_holdout']:.{digits}f} ± {found[f'{name}_error_holdout']:.{digits}f}"
                for name, digits in (("flip", 4), ("colour", 2))
            ]
            kilobytes, psnr = encoded.encoded_bytes, found["pooled_holdout"]
            rows.append([stack.name, f"{rate:g}", metric, f"{kilobytes / 1000:.1f}", f"{psnr:.2f}", *seen])
            if picture is not None and rate == RATES[0]:
                shown_khwc, curve = decode_shown(encoded, device)
                drawn.append(Found(metric, kilobytes, psnr, replace(fitted, coeffs_khwc=shown_khwc), curve))
    if picture is not None:
        held = split_chosen(stack.directions_i3, HOLDOUT)[1]
        draw_ways(picture, stack, int(held[len(held) // 2]), drawn)
    return rows


if __name__ == "__main__":
    main()
