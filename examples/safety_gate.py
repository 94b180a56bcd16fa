"""
Limits of the safety gate
=========================

The safety gate proves each sequence safe, and sends exactly the copy that it has proved. If a
sequence exceeds a limit, `send` raises an error with the value. Values are never clamped.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

# %%
# Load a profile, and make a sequence from the letter a. Then print two limits of the profile.
profile = st.load_profile("electric-mouse")
source = st.open_source("text:a", profile, speed_mm_s=60)
step = max(st.steps(source, profile, mode="RA"), key=lambda each: each.sequence.slots)
sequence = step.sequence

limits = st.SafetyLimits.of(profile)
print(f"limits: {limits.current_ma} mA per electrode, {limits.total_ma} mA per slot")


# %%
# Try to send six sequences that each break one rule, and print the errors.
def changed(**fields):
    return replace(sequence, **fields)


unbalanced = sequence.current_ua.copy()
unbalanced[0, 0] += 100
wrong = {
    "full intensity without a ramp": sequence,
    "four times the current": changed(current_ua=(4 * sequence.current_ua).astype(np.int16)),
    "currents that do not add up to zero": changed(current_ua=unbalanced),
    "a longer pulse": changed(width_us=np.full_like(sequence.width_us, 300)),
    "no discharge": changed(discharge_us=np.zeros_like(sequence.discharge_us)),
    "not a number": changed(intensity=float("nan")),
}
for name, each in wrong.items():
    with st.open_display("simulated:", profile) as display, display.board as board:
        try:
            board.send(each)
        except st.SafetyError as error:
            print(f"{name}: {error}")
        else:
            raise AssertionError(f"{name} was sent")


# %%
# In a run, the ramp raises intensity from zero, even if the finger presses hard at once.
class Disc(st.OpticalSource):
    """Source of frames: a black disc under a finger that presses from 0.2 to 1.4 s."""

    knows_force = True

    def read(self, time_ns):
        if time_ns >= 1.6e9:
            return None
        place = np.arange(64) - 31.5
        disc = np.where(np.hypot(place, place[:, None]) < 20, 20, 230).astype(np.uint8)
        self.frames += 1
        force_n = 1.0 if 0.2e9 <= time_ns < 1.4e9 else 0.0
        return st.Frame(disc, time_ns, force_n=force_n, number=self.frames - 1)


results: list[st.StepResult] = []
with st.open_display("simulated:", profile) as display:
    st.run(Disc("a disc"), display, mode="RA", listeners=[results.append])
figure, axes = plt.subplots(figsize=(6, 2.4), layout="constrained")
time_s = [each.input.time_ns / 1e9 for each in results]
axes.plot(time_s, [each.delivered_ma.max() for each in results], ".", label="strongest point")
axes.axhline(limits.current_ma, color="#707070", ls=":", label="limit")
axes.set(xlabel="time (s)", ylabel="current (mA)", ylim=(0, None))
axes.legend(frameon=False)
plt.show()
