"""
From an image to the skin
=========================

This program defines its own electrode array, source and board, and runs them together.
"""

import tomllib

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.plugins import Capabilities

# %%
# Copy a profile with an array of 5 x 5 discs and other optics. The copy is validated like a file.
OWN = """
array = {layout="grid", rows=5, columns=5, pitch_x_mm=2, pitch_y_mm=2, diameter_mm=1}
optics = {sensor_rows=64, sensor_columns=64, field_width_mm=9, field_height_mm=9, magnification=1}
"""
profile = st.load_profile("electric-mouse").model_copy(update=tomllib.loads(OWN))


class Sliding(st.OpticalSource):
    """Source of frames: a ring of ink that slides under the finger within a second."""

    knows_force = True

    def read(self, time_ns):
        y, x = np.mgrid[:64, :64]
        image = np.where(abs(np.hypot(x - 64e-9 * time_ns, y - 32) - 21) < 8, 0, 255)
        self.frames += 1
        return st.Frame(image.astype(np.uint8), time_ns, force_n=0.9, number=self.frames - 1)


class ListDriver(st.Driver):
    """Driver that stores, in a list, each sequence that was proved safe."""

    def open(self, line, limits):
        self.line, self.sequences = line, []
        return Capabilities(25, "weighted", 3.0, max_slots=99, time_to_zero_ms=0, firmware="list")

    def write(self, proved):
        with self.line.current(proved):
            self.sequences.append(proved.sequence)

    def zero(self): ...


own = {"on_a_finger": False, "claimed_time": True}
steps, board = [], st.Board(ListDriver(), st.SafetyLimits.of(profile), **own)
display = st.open_display(board, profile)
print(st.run(Sliding("a ring"), display, seconds=1, listeners=[steps.append]).slots, "slots")
figure, (touched, sent) = plt.subplots(1, 2, layout="constrained")
fullest = max(steps, key=lambda step: step.sequence.slots)
touched.imshow(fullest.tactile.activation[st.Afferent.RA].reshape(5, 5), cmap="Greys")
sent.imshow(fullest.sequence.current_ua, cmap="PuOr_r", vmin=-3000, vmax=3000, aspect="auto")
plt.show()
