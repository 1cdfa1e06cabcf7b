"""
A mesh under a sky
==================

What each vertex makes of light, with shadows and two bounces; then pictures of it. See :doc:`/surfaces`.
"""

import matplotlib.pyplot as plt
import numpy as np

import clrelight as cr


def grid_faces(rows: int, columns: int, first: int, *, closed: bool) -> list[tuple[int, int, int]]:
    """Return two triangles for each cell of a grid of vertices that are numbered row by row."""
    faces = []
    for row in range(rows if closed else rows - 1):
        for column in range(columns if closed else columns - 1):
            below, beside = (row + 1) % rows, (column + 1) % columns
            a, b, c, d = (
                first + r * columns + k for r, k in ((row, column), (below, column), (below, beside), (row, beside))
            )
            faces += [(a, b, c), (a, c, d)]
    return faces


# A red torus leans over a grey plate.
u, v = np.meshgrid(2 * np.pi * np.arange(64) / 64, 2 * np.pi * np.arange(32) / 32, indexing="ij")
out = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=-1).reshape(-1, 3)
middle = np.stack([np.cos(u), np.sin(u), 0 * u], axis=-1).reshape(-1, 3)
lean = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
torus, torus_normals = (middle + 0.3 * out) @ lean.T + (0, 0, 0.95), out @ lean.T
x, y = np.meshgrid(np.linspace(-2, 2, 49), np.linspace(-2, 2, 49), indexing="ij")
plate = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=-1)

surface = cr.Surface(
    np.concatenate([torus, plate]),
    np.array(grid_faces(64, 32, 0, closed=True) + grid_faces(49, 49, len(torus), closed=False), np.int32),
    np.concatenate([torus_normals, np.tile([0.0, 0.0, 1.0], (len(plate), 1))]),
    albedo_vc=np.array([[0.8, 0.25, 0.15]] * len(torus) + [[0.7, 0.7, 0.7]] * len(plate), np.float32),
)

# %%
# 25 numbers a vertex and colour. They are fitted, coded and measured as pixels are.

functions = cr.transfer(surface, kind="interreflected", bounces=2, samples=400, degree=4)
print(functions.coeffs_khwc.shape)

sky = cr.sky_light("clear", 35, 200, degree=4)
turned = cr.rotate_light(sky, cr.rotation_matrix("axis", (0, 0, 1, 120)))
lights = {"clear sky": sky, "the same, turned": turned, "a lamp": (1, 0.5, 1)}
figure, axes = plt.subplots(1, 3, figsize=(11, 3))
for axis, (title, light) in zip(axes, lights.items(), strict=True):
    image = cr.render(functions, light, size=(240, 180), camera=(-0.2, -1, 0.9))
    axis.imshow(np.clip(image[..., :3] / np.percentile(image, 99), 0, 1) ** (1 / 2.2))
    axis.set_title(title)
    axis.axis("off")
figure.tight_layout()
plt.show()
