"""
Your own imaging: a tactile sensor with a gel
=============================================

A camera behind a gel sees how deep an object presses into the gel. In this example, a class of your
own replaces the imaging of text: depth stimulates SAI, and changes of depth stimulate RA.
"""

from collections.abc import Iterator

import cv2
import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.types import ElectrodeArray


def indentations(count: int = 60) -> Iterator[np.ndarray]:
    """Yield the camera's images while a ball is pressed into the gel and then rolls over it."""
    y, x = np.mgrid[0:64, 0:64] / 64 * 14  # mm
    for step in range(count):
        press, along = min(1.0, step / 20), 4 + 6 * max(0, step - 20) / 40
        depth = np.clip(press - ((x - along) ** 2 + (y - 7) ** 2) / 6, 0, 1)
        yield (255 - 200 * depth).astype(np.uint8)


class Indentation:
    """Imaging that maps depth to SAI, and the change of depth between frames to RA."""

    before: np.ndarray | None = None

    def __call__(self, frame: st.Frame, electrodes: ElectrodeArray) -> np.ndarray:
        cells = cv2.resize(frame.image, (8, 8), interpolation=cv2.INTER_AREA)
        depth = (255 - cells).astype(np.float32).ravel() / 255
        change = np.abs(depth - (depth if self.before is None else self.before))
        self.before = depth
        return np.stack([np.clip(8 * change, 0, 1), depth, 0 * depth])


# %%
# Pass the images and the imaging to `run`.

results: list[st.StepResult] = []
display = st.open_display("simulated:", "electric-mouse")
statistics = st.run(
    indentations(), display, mode="natural", imaging=Indentation(), listeners=[results.append]
)
print(f"{statistics.frames} sequences, {statistics.slots} slots")

# %%
# Draw SAI (top) and RA (bottom) while the ball is pressed in (columns 1, 2) and rolls (column 3).

figure, axes = plt.subplots(2, 3, figsize=(7, 4.6), layout="constrained")
for column, when in zip(axes.T, (10, 20, 50), strict=True):
    tactile = results[when].tactile
    for axis, afferent in zip(column, (st.Afferent.SAI, st.Afferent.RA), strict=True):
        axis.imshow(tactile.activation[afferent].reshape(8, 8), vmin=0, vmax=1, cmap="magma")
        axis.set(xticks=[], yticks=[], title=f"{afferent.name}, {tactile.time_ns / 1e9:.2f} s")
plt.show()
