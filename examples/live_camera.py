"""
Live camera in OpenCV
=====================

``smarttouch live camera:0`` opens a camera. If your own program gets frames from OpenCV, pass them
to SmartTouch with a source: a class with one method. This example runs without a camera: a class
simulates a camera that moves over a printed line.
"""

import cv2
import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.lab import print_text


class Film:
    """Simulated camera that pans over a printed line. `read` works as in ``cv2.VideoCapture``."""

    def __init__(self, text):
        grey = print_text(text).grey
        rows, columns = (np.flatnonzero((grey < 200).any(axis=axis)) for axis in (1, 0))
        line = grey[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        self.grey, self.left = np.pad(line, (10, len(line)), constant_values=255), 0

    def read(self):
        """Return whether there is a frame, and the frame or None."""
        height = self.grey.shape[0]
        window = self.grey[:, self.left : self.left + height]
        self.left += 1
        if window.shape[1] < height:
            return False, None
        return True, cv2.cvtColor(window, cv2.COLOR_GRAY2BGR)


class CameraSource(st.OpticalSource):
    """Source of frames from a camera object, for example a ``cv2.VideoCapture``."""

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
        # OpenCV's channel order is blue, green, red; a `Frame` needs red, green, blue.
        return st.Frame(small[:, :, ::-1], time_ns, force_n=0.9, number=self.frames - 1)


# %%
# Run the source. For a real camera use ``CameraSource(cv2.VideoCapture(0), profile)``.
profile = st.load_profile("electric-mouse")
kept = []
with st.open_display("simulated:", profile) as display:
    source = CameraSource(Film("touch"), profile)
    statistics = st.run(source, display, mode="RA", listeners=[kept.append])
print(f"{statistics.frames} frames")

# %%
# Draw some frames of the camera and, below each, the current at each point of the array.
figure, panels = plt.subplots(2, 6, figsize=(9, 3.2), layout="constrained")
for column, result in zip(panels.T, kept[:: max(1, len(kept) // 6)], strict=False):
    column[0].imshow(result.input.image, cmap="gray", vmin=0, vmax=255)
    column[1].imshow(result.delivered_ma.reshape(8, 8), cmap="Greys", vmin=0, vmax=3)
for axes in panels.flat:
    axes.set(xticks=[], yticks=[])
panels[0, 0].set_ylabel("camera")
panels[1, 0].set_ylabel("0 to 3 mA")
plt.show()
