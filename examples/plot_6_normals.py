"""
Which way a surface faces
=========================

Photographs of a head under 32 lamps: normals and albedo, and how far off they are. See :doc:`/normals`.
"""

import matplotlib.pyplot as plt
import numpy as np

import clrelight as cr
from clrelight.sampling import make_pattern
from datasets_synth.heads import make_head, shade_head

head = make_head(3, size=64)
directions_i3 = make_pattern("uniform", 32)
shade_ip = shade_head(head, directions_i3)
radiance_ipc = 0.8 * shade_ip[..., None] * head.albedo_hwc[head.mask_hw]
radiance_ipc += np.random.default_rng(0).normal(0, 0.01, radiance_ipc.shape)  # the noise of a camera
images = np.zeros((32, 64, 64, 3), np.uint8)
images[:, head.mask_hw] = np.clip(255 * radiance_ipc + 0.5, 0, 255)
stack = cr.LightStack(images, directions_i3, 255.0, mask_hw=head.mask_hw)

found = cr.normals(stack)
cosine_p = (found.normals_hw3 * head.normals_hw3).sum(axis=2)[head.mask_hw]
off_hw = np.full((64, 64), np.nan)
off_hw[head.mask_hw] = np.degrees(np.arccos(np.clip(cosine_p, -1, 1)))
print(f"{np.nanmedian(off_hw):.2f} degrees off in the median")

figure, axes = plt.subplots(1, 4, figsize=(11, 3))
axes[0].imshow((images[5] / 255) ** (1 / 2.2))
axes[1].imshow(np.where(head.mask_hw[..., None], 0.5 + 0.5 * found.normals_hw3, 1))
axes[2].imshow(np.clip(found.albedo_hwc / np.nanmax(found.albedo_hwc), 0, 1) ** (1 / 2.2))
shown = axes[3].imshow(off_hw, vmax=10)
for axis, title in zip(axes, ("a photograph", "normals", "albedo", "degrees off"), strict=True):
    axis.set_title(title)
    axis.axis("off")
figure.colorbar(shown)
figure.tight_layout()
plt.show()
