"""
How many photographs
====================

Before any is taken: what lights are worth, from their directions alone. See :doc:`/sampling`.
"""

import matplotlib.pyplot as plt
import numpy as np

from clrelight.plan_lights import assess_lights, propose_lights

counts = (36, 49, 64, 96, 128)
figure, noise = plt.subplots(figsize=(6, 4))
for pattern in ("greedy", "farthest", "uniform"):
    values = [assess_lights(propose_lights(pattern, count, 5), 5).image_noise for count in counts]
    noise.semilogy(counts, values, "o-", label=pattern)
noise.axhline(1, color="grey", lw=1)
noise.set(xlabel="lights", ylabel="noise of a relit picture, of a photograph's", title="degree 5")
noise.legend()
figure.tight_layout()
plt.show()

# %%
# Where the 49 of ``greedy`` are, seen from above: the first ones count most.

directions_i3 = propose_lights("greedy", 49, 5)
figure, places = plt.subplots(figsize=(5, 4))
dots = places.scatter(directions_i3[:, 0], directions_i3[:, 1], c=np.arange(49), cmap="viridis")
places.add_patch(plt.Circle((0, 0), 1, fill=False, color="grey"))
places.set(aspect="equal", xlabel="x, right", ylabel="y, up")
figure.colorbar(dots, label="taken as number")
figure.tight_layout()
plt.show()
