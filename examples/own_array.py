"""An array of your own, from a TOML file to kernels, tactile images, sequences and a run.

Writes own_array.png into the folder it is run in.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import smarttouch as st

profile = st.load_profile(Path(__file__).with_name("own_array.toml"))


class Wipe(st.OpticalSource):
    """A black bar that wipes over white paper in a second."""

    knows_force = True

    def read(self, time_ns):
        if time_ns >= 1e9:
            return None
        image = np.full((64, 64), 255, np.uint8)
        left = int(time_ns / 1e9 * 50)
        image[:, left : left + 14] = 0
        self.frames += 1
        return st.Frame(image, time_ns, force_n=0.9, number=self.frames - 1)


kernel = st.design_kernel(profile, "RA", 12)  # in the middle; positive is cathodic
kernels = st.load_kernels(profile)  # all of them, kept for the next time

# Each frame with its tactile image and sequence, without a board or a clock.
steps = list(st.steps(Wipe("a bar"), profile, mode="RA", kernels=kernels))

# The same on a display, which proves each sequence safe before it is sent.
strongest_ma = []
with st.open_display("simulated:", profile) as display:
    statistics = st.run(
        Wipe("a bar"),
        display,
        mode="RA",
        listeners=[lambda result: strongest_ma.append(result.felt_ma.max())],
    )
print(f"{statistics.frames} frames, {statistics.slots} slots, {max(strongest_ma):.2f} mA at most")

figure = Figure(figsize=(9, 3.2), layout="constrained")
seen, touched, sent = figure.subplots(1, 3)
middle = steps[len(steps) // 2]
seen.imshow(middle.input.image, cmap="gray", vmin=0, vmax=255)
seen.set_title("frame")
touched.imshow(
    middle.tactile.activation[st.Afferent.RA].reshape(5, 5), cmap="Greys", vmin=0, vmax=1
)
touched.set_title("tactile image, RA")
most_ma = np.abs(middle.sequence.current_ua).max() / 1000
image = sent.imshow(middle.sequence.current_ua / 1000, cmap="RdBu", vmin=-most_ma, vmax=most_ma)
sent.set(title="sequence", xlabel="electrode", ylabel="slot")
figure.colorbar(image, label="mA, cathodic positive")
figure.savefig("own_array.png", dpi=120)
