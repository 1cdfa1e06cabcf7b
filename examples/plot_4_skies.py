"""
A lamp, a softer lamp, a sky
============================

A fit that holds the response to each direction answers to light from everywhere, by one dot product a pixel.
"""

import matplotlib.pyplot as plt
import numpy as np

import clrelight as cr
from datasets_synth.ring import render_ring

stack = render_ring(size=64, lights=128)
fitted = cr.fit(stack, "spline", 8, measure=False)

towards = (-0.7, 0.3, 0.5)
lights = {
    "a lamp": cr.directional_light(towards, 8),
    "round, 25° to its rim": cr.cap_light(towards, 25, 8),
    "clear sky, low sun": cr.sky_light("clear", 15, 150, degree=8),
    "overcast": cr.sky_light("overcast", degree=8),
}

figure, axes = plt.subplots(1, 4, figsize=(11, 3.1))
for axis, (title, light) in zip(axes, lights.items(), strict=True):
    image = cr.relight(fitted, light)
    axis.imshow(np.clip(image / np.percentile(image, 99), 0, 1) ** (1 / 2.2))
    axis.set_title(title)
    axis.axis("off")
figure.tight_layout()
plt.show()

# %%
# The same sky, turned about the zenith:

frames = cr.relight(fitted, lights["clear sky, low sun"], turntable=6)
figure, axes = plt.subplots(1, 6, figsize=(11, 2.1))
for axis, image in zip(axes, frames, strict=True):
    axis.imshow(np.clip(image / np.percentile(frames, 99), 0, 1) ** (1 / 2.2))
    axis.axis("off")
figure.tight_layout()
plt.show()
