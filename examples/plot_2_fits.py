"""
Which fit
=========

Lights are above the horizon only, where spherical harmonics are nearly dependent. Coefficients of plain least squares
are then huge: they meet the photographs, and fall apart as soon as they are compressed or asked for a light between the
others.
"""

import matplotlib.pyplot as plt
import numpy as np

import clrelight as cr
from datasets_synth.ring import render_ring

stack = render_ring(size=64, lights=128)

methods = ("uls", "cls", "spline", "spectrum")
pictures, rows = [], []
for method in methods:
    fitted = cr.fit(stack, method, 6, holdout=5)
    small = cr.encode(fitted, "s3tc")
    plain, coded = cr.measure(fitted, stack), cr.measure(small, stack)
    rows.append((method, plain["mean_fitted"], plain["mean_holdout"], coded["mean_holdout"]))
    pictures.append(cr.relight(small, (0.4, 0.3, 0.8)))

print("method    fitted  held out  held out, S3TC")
for row in rows:
    print("{:9} {:6.2f}  {:8.2f}  {:14.2f}".format(*row))

# %%
# The same light, after texture compression:

figure, axes = plt.subplots(1, 4, figsize=(11, 3.1))
for axis, image, row in zip(axes, pictures, rows, strict=True):
    axis.imshow(np.clip(image, 0, 1) ** (1 / 2.2))
    axis.set_title(f"{row[0]}: {row[3]:.1f} dB")
    axis.axis("off")
figure.tight_layout()
plt.show()
