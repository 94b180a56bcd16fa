"""
Tactile primary colors
======================

As a screen mixes red, green and blue, a vibration is split into what each class of receptor would
answer, and each class is let fire as its afferents would have.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
from studies.vibration_figures import draw_mixture, thresholds_figure

import smarttouch as st
from smarttouch.lab import mix_colors, open_trace

# %%
# The basis of it: the smallest vibration that each class answers, by frequency. RA is best at 30
# Hz, PC at 250 Hz, SAI answers what is static.
thresholds_figure()

# %%
# Two vibrations and a press at once.
trace = open_trace("tone:30Hz,9um+tone:250Hz,1.5um+press:0.45N")
profile = st.load_profile("electric-mouse")
mixture = mix_colors(trace, profile, st.load_kernels(profile))
for afferent, answer in mixture.answers.items():
    print(f"{afferent.name}: drive {answer.drive.mean():.2f}")

# %%
# Pulses for each class, at its own rate, by its own kernels.
draw_mixture(trace, mixture)
plt.show()

# %%
# PC by a mechanical vibrator instead of current (the paper's hybrid display): it plays into a file
# what the sequences ask for.
path = Path(mkdtemp()) / "pc.wav"
tone = "vibration:tone:200Hz,2um"
st.run(tone, "simulated:", mode="color", seconds=0.5, listeners=[st.Vibrator(path)])
print(f"{path.stat().st_size} bytes of sound")
