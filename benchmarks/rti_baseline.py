"""Print what the RTI tools' way reaches at held-out lights: ``python -m benchmarks.rti_baseline STACK.h5 ...``."""

import argparse

from clrelight.baseline import BASES, measure_rti
from clrelight.holdout import split_chosen
from clrelight.store import open_stack

QUALITIES = (None, 100, 98, 95, 90, 80)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stacks", nargs="+", metavar="STACK.h5")
    parser.add_argument("--holdout", type=int, default=5, help="keep every K-th light out of the fit (default 5)")
    arguments = parser.parse_args()
    print(f"{'stack':16} {'basis':6} {'jpeg':>5} {'kB':>9} {'held out dB':>12} {'mean dB':>8} {'fitted dB':>10}")
    for path in arguments.stacks:
        with open_stack(path) as stack:
            fitted, held_out = split_chosen(stack.directions_i3, arguments.holdout)
            for basis in BASES:
                for found in measure_rti(stack, fitted, held_out, basis, QUALITIES):
                    quality = "float" if found.quality is None else found.quality
                    print(
                        f"{stack.name:16} {basis:6} {quality:>5} {found.encoded_bytes / 1000:9.1f}"
                        f" {found.psnr_pooled:12.2f} {found.psnr_mean:8.2f} {found.psnr_pooled_fitted:10.2f}"
                    )


if __name__ == "__main__":
    main()
