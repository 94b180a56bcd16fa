"""
How far the activating function can be trusted
==============================================

Kernels are designed with the activating function (AF), which ignores the membrane of a fiber. If
the AF were enough, all fibers would fire at the same AF, and the threshold of one fiber would
predict that of any other fiber. Here a flat fiber 0.9 mm below a cathode predicts all thresholds.
The predictions are compared with a cable model, which has an active membrane.
"""

import matplotlib.pyplot as plt
import numpy as np
from studies.af_error import DEPTHS_MM, af_error_table, ratio_rows

import smarttouch as st
from smarttouch.lab import ANODIC, CATHODIC

# %%
# Print the predicted threshold divided by the threshold of the cable model, for each depth in mm.
# If this ratio is below 1, the fiber is harder to fire than predicted. Only the ratios of flat
# fibers are within 0.8 to 1.2.
table = af_error_table(st.load_profile("electric-mouse"))
for fiber, polarity, *ratios in ratio_rows(table):
    print(f"{fiber:24}{polarity:10}" + "".join(f"{each:>7}" for each in ratios))

# %%
# Plot both thresholds over depth.
fibers = list(dict.fromkeys(row.fiber for row in table))
figure, panels = plt.subplots(1, len(fibers), figsize=(8.4, 3.2), sharey=True, layout="constrained")
for axes, fiber in zip(panels, fibers, strict=True):
    for polarity, color in (("cathodic", CATHODIC), ("anodic", ANODIC)):
        rows = [row for row in table if (row.fiber, row.polarity) == (fiber, polarity)]
        cable_ma, af_ma = (np.array([getattr(row, each) for row in rows])
                           for each in ("cable_ma", "af_ma"))  # fmt: skip
        axes.plot(DEPTHS_MM, cable_ma, "o-", color=color, ms=3.5, label=f"{polarity}, cable model")
        never = ": never" if np.isinf(af_ma).all() else ""
        axes.plot(DEPTHS_MM, np.where(np.isinf(af_ma), np.nan, af_ma), "--", color=color,
                  label=f"{polarity}, from the AF{never}")  # fmt: skip
    axes.set(yscale="log", title=fiber, xlabel="depth (mm)")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xticks(DEPTHS_MM, [f"{depth:g}" for depth in DEPTHS_MM])
    axes.legend(frameon=False, fontsize=6.5, loc="upper left")
panels[0].set_ylabel("threshold (mA)")
low, high = panels[0].get_ylim()
panels[0].set_ylim(low, high * 6)
plt.show()
