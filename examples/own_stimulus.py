"""
Touch without a sensor
======================

A stimulus source returns tactile images instead of frames, so it chooses the activation of each
electrode. Here a point moves in a circle. A listener counts the pulses of each electrode.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.lab import profile_for_reading, reading_force_n


# %%
# Define a source. Its `read` returns the stimulus at a time, here with a duration of 20 ms. Each
# active electrode pulses once per stimulus.
class Circle(st.StimulusSource):
    """Source of RA stimuli: a point that moves twice around the middle of the array."""

    knows_force = True

    def __init__(self, profile: st.Profile) -> None:
        super().__init__("a point in a circle")
        self._place_mm = profile.electrodes.position_mm
        self._press_n = reading_force_n(profile)
        self.duration_s = 2.0

    def read(self, time_ns: int) -> st.Stimulus | None:
        if time_ns >= 2e9:
            return None
        turn = 2 * math.pi * time_ns / 1e9
        middle_mm = 5 * np.array([math.cos(turn), math.sin(turn)])
        away_mm = np.linalg.norm(self._place_mm - middle_mm, axis=1)
        activation = np.zeros((3, len(away_mm)), np.float32)
        activation[st.Afferent.RA] = np.clip(1.5 - away_mm / 2, 0, 1)
        self.frames += 1
        return st.Stimulus(activation, time_ns, self._press_n, 20_000, number=self.frames - 1)


# %%
# Define a listener. The run calls `step` with each step that was sent.
class Trail(st.Listener):
    """Listener that counts the pulses of each electrode."""

    def __init__(self, display: st.Display) -> None:
        super().__init__()
        self.pulses = np.zeros(len(display.profile.electrodes), int)
        self.slots: list[int] = []

    def step(self, result: st.StepResult) -> None:
        image: st.TactileImage = result.tactile
        sequence: st.ScanSequence = result.sequence
        self.pulses += image.activation.any(axis=0)
        self.slots.append(sequence.slots)


profile = profile_for_reading(st.load_profile("electric-mouse"))
with st.open_display("simulated:", profile) as display:
    trail = Trail(display)
    statistics: st.RunStatistics = st.run(Circle(profile), display, mode="RA", listeners=[trail])
print(f"{statistics.frames} stimuli of up to {max(trail.slots)} slots, {statistics.slots} in total")

# %%
# Draw the number of pulses of each electrode.
figure, axes = plt.subplots(figsize=(4.6, 4), layout="constrained")
x_mm, y_mm = profile.electrodes.position_mm.T
drawn = axes.scatter(x_mm, y_mm, c=trail.pulses, cmap="Oranges", s=160, edgecolors="#707070")
axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
axes.invert_yaxis()
figure.colorbar(drawn, label="pulses")
plt.show()
