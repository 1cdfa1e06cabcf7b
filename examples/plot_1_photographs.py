"""
From photographs to a picture under a new light
===============================================

A folder of photographs and a light file become one file, which is lit from where no lamp stood. The photographs are
rendered here, so that there are some.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import OpenImageIO as oiio

import clrelight as cr
from datasets_synth.ring import render_ring

scene = render_ring(size=64, lights=80)
place = tempfile.TemporaryDirectory()
folder = Path(place.name)
photos = folder / "photos"
photos.mkdir()
lines = [str(scene.n_light)]
for i, (image_hwc, (x, y, z)) in enumerate(zip(scene.images_ihwc, scene.directions_i3, strict=True)):
    name = f"{i:02}.png"
    picture = oiio.ImageBuf(np.ascontiguousarray(image_hwc))
    picture.write(str(photos / name))
    lines.append(f"{name} {x:.6f} {y:.6f} {z:.6f}")
(photos / "dome.lp").write_text("\n".join(lines) + "\n")

# %%
# ``pack`` chooses the model, and keeps every fifth photograph out to say how good it is. These photographs are linear;
# for those of a camera it is ``transfer="srgb"``.

report = cr.pack(photos, folder / "view.h5", lights=photos / "dome.lp", holdout=5)
print(f"{report.psnr['mean_holdout']:.2f} dB at lights left out, {report.psnr['mean_fitted']:.2f} dB at the others")
print(report.facts["bytes_on_disk"], "bytes for", 80 * 64 * 64 * 3, "of samples")

# %%
# Any direction, from the surface to the light, of any length:

directions = [(-0.8, 0.2, 0.5), (0, 0, 1), (0.8, 0.2, 0.5)]
images = cr.relight(folder / "view.h5", directions)

figure, axes = plt.subplots(1, 3, figsize=(9, 3.2))
for axis, image, direction in zip(axes, images, directions, strict=True):
    axis.imshow(np.clip(image, 0, 1) ** (1 / 2.2))
    axis.set_title(f"light {direction}")
    axis.axis("off")
figure.tight_layout()
plt.show()
