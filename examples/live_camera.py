"""
Live camera in OpenCV
=====================

``smarttouch live camera:0`` takes a camera. In a program of your own that has its frames
from OpenCV already, a source is a class with one method. Where there is no camera, this example
films a page by moving a window over it.
"""

import cv2
import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.lab import print_text


class Film:
    """Stands in for ``cv2.VideoCapture(0)``: a camera that pans over a printed line."""

    def __init__(self, text):
        grey = print_text(text).grey
        rows, columns = (np.flatnonzero((grey < 200).any(axis=axis)) for axis in (1, 0))
        line = grey[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        self.grey, self.left = np.pad(line, (10, len(line)), constant_values=255), 0

    def read(self):
        """Return whether there is a frame, and the frame, as OpenCV does."""
        height = self.grey.shape[0]
        window = self.grey[:, self.left : self.left + height]
        self.left += 1
        if window.shape[1] < height:
            return False, None
        return True, cv2.cvtColor(window, cv2.COLOR_GRAY2BGR)


class CameraSource(st.OpticalSource):
    """Gives the frames of anything that has the ``read`` of ``cv2.VideoCapture``."""

    knows_force = True

    def __init__(self, camera, profile):
        super().__init__("a camera")
        self._camera = camera
        self._size = profile.optics.sensor_columns, profile.optics.sensor_rows

    def read(self, time_ns):
        there, image = self._camera.read()
        if not there:
            return None
        small = cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)
        self.frames += 1
        # OpenCV has blue first; a frame takes red first, or grey levels.
        return st.Frame(small[:, :, ::-1], time_ns, force_n=0.9, number=self.frames - 1)


# %%
# With a camera at hand: ``CameraSource(cv2.VideoCapture(0), profile)``.
profile = st.load_profile("electric-mouse")
kept = []
with st.open_display("simulated:", profile) as display:
    source = CameraSource(Film("touch"), profile)
    statistics = st.run(source, display, mode="RA", listeners=[kept.append])
print(f"{statistics.frames} frames")

# %%
# What the camera saw, and what the electrodes did.
figure, panels = plt.subplots(2, 6, figsize=(9, 3.2), layout="constrained")
for column, result in zip(panels.T, kept[:: max(1, len(kept) // 6)], strict=False):
    column[0].imshow(result.input.image, cmap="gray", vmin=0, vmax=255)
    column[1].imshow(result.delivered_ma.reshape(8, 8), cmap="Greys", vmin=0, vmax=3)
for axes in panels.flat:
    axes.set(xticks=[], yticks=[])
panels[0, 0].set_ylabel("camera")
panels[1, 0].set_ylabel("mA, 0 to 3")
plt.show()
