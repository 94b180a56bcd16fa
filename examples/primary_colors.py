"""
Tactile primary colors
======================

A screen mixes colors from red, green and blue. In the same way, this program splits a vibration
into the responses of RA, SAI and PC, and stimulates each class at the times of its response.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
from studies.vibration_figures import draw_mixture, thresholds_figure

import smarttouch as st
from smarttouch.lab import mix_colors, open_trace

# %%
# Draw the threshold of each class: the smallest vibration to which the class responds, over
# frequency. RA is most sensitive at 30 Hz, PC at 250 Hz. SAI responds to static pressure.
thresholds_figure()

# %%
# Split a trace of two vibrations and constant pressure.
trace = open_trace("tone:30Hz,9um+tone:250Hz,1.5um+press:0.45N")
profile = st.load_profile("electric-mouse")
mixture = mix_colors(trace, profile, st.load_kernels(profile))
for afferent, answer in mixture.answers.items():
    print(f"{afferent.name}: mean drive {answer.drive.mean():.2f}")

# %%
# Draw the trace, and the response and the pulses of each class.
draw_mixture(trace, mixture)
plt.show()

# %%
# Drive PC by a mechanical vibrator instead of current, as in the paper's hybrid display. `Vibrator`
# writes the vibrator's signal to a file.
path = Path(mkdtemp()) / "pc.wav"
tone = "vibration:tone:200Hz,2um"
st.run(tone, "simulated:", mode="color", seconds=0.5, listeners=[st.Vibrator(path)])
print(f"{path.name}: {path.stat().st_size} bytes")
