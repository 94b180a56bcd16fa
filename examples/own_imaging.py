"""
A fingertip camera with a gel
=============================

Where a gel fingertip presses on something, its camera sees how deep. Depth becomes pressure (SAI),
and where depth changes, touch (RA): imaging of one's own in place of binarization.
"""

from collections.abc import Iterator

import cv2
import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.types import ElectrodeArray


def indentations(count: int = 60) -> Iterator[np.ndarray]:
    """Yield what the camera sees while a ball of 3 mm is pressed into the gel and rolls away."""
    y, x = np.mgrid[0:64, 0:64] / 64 * 14  # mm
    for step in range(count):
        press, along = min(1.0, step / 20), 4 + 6 * max(0, step - 20) / 40
        depth = np.clip(press - ((x - along) ** 2 + (y - 7) ** 2) / 6, 0, 1)
        yield (255 - 200 * depth).astype(np.uint8)


class Indentation:
    """Activation of SAI by depth, and of RA by its change from frame to frame."""

    before: np.ndarray | None = None

    def __call__(self, frame: st.Frame, electrodes: ElectrodeArray) -> np.ndarray:
        cells = cv2.resize(frame.image, (8, 8), interpolation=cv2.INTER_AREA)
        depth = (255 - cells).astype(np.float32).ravel() / 255
        change = np.abs(depth - (depth if self.before is None else self.before))
        self.before = depth
        return np.stack([np.clip(8 * change, 0, 1), depth, 0 * depth])


# %%
# The same call as for text; recordings keep the images and what was made of them.

results: list[st.StepResult] = []
display = st.open_display("simulated:", "electric-mouse")
statistics = st.run(
    indentations(), display, mode="natural", imaging=Indentation(), listeners=[results.append]
)
print(f"{statistics.frames} sequences, {statistics.slots} slots")

# %%
# Pressed, and rolling: SAI where the ball is, RA along its edge.

figure, axes = plt.subplots(2, 3, figsize=(7, 4.6), layout="constrained")
for column, when in zip(axes.T, (10, 20, 50), strict=True):
    tactile = results[when].tactile
    for axis, afferent in zip(column, (st.Afferent.SAI, st.Afferent.RA), strict=True):
        axis.imshow(tactile.activation[afferent].reshape(8, 8), vmin=0, vmax=1, cmap="magma")
        axis.set(xticks=[], yticks=[], title=f"{afferent.name}, {tactile.time_ns / 1e9:.2f} s")
plt.show()
