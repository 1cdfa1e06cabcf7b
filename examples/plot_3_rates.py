"""
How small
=========

The bytes that a view takes, and what each choice costs at lights that were not fitted.
"""

import matplotlib.pyplot as plt

import clrelight as cr
from datasets_synth.ring import render_ring

stack = render_ring(size=64, lights=96)
fitted = cr.fit(stack, "spline", 6, holdout=5, measure=False)

curves: dict[str, list[tuple[float, float]]] = {}
for codec, settings in (
    ("klt", [{"rate": rate} for rate in (0.03, 0.06, 0.12, 0.25, 0.5)]),
    ("wavelet", [{"rate": rate} for rate in (0.12, 0.25, 0.5, 1.0)]),
    ("s3tc", [{}]),
    ("half", [{}]),
):
    for options in settings:
        small = cr.encode(fitted, codec, **options)
        decibel = cr.measure(small, stack)["mean_holdout"]
        curves.setdefault(codec, []).append((small.encoded_bytes / 1000, decibel))

# %%
# ``klt`` codes in the metric of what will be seen; the others code coefficients as they are.

figure, axis = plt.subplots(figsize=(6.5, 4))
for codec, points in curves.items():
    axis.semilogx(*zip(*points, strict=True), "o-", label=codec)
axis.set(xlabel="kB, side tables included", ylabel="PSNR at lights left out (dB)")
axis.grid(alpha=0.3)
axis.legend()
figure.tight_layout()
plt.show()
