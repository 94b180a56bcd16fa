"""Picture of a vibration: its trace, the answers of three classes, and their pulses."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from smarttouch.afferent import Afferent
from smarttouch.plotting.colors import ClassRow, color_figure
from smarttouch.vibrotactile.mix import Mixture
from smarttouch.vibrotactile.split import Answer
from smarttouch.vibrotactile.trace import Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def picture(
    trace: Trace, answers: Mapping[Afferent, Answer], mixture: Mixture | None = None
) -> "Figure":
    """Draw a vibration, what each class answers, and the pulses if there are any."""
    rows = {}
    for afferent, answer in answers.items():
        which = np.empty(0, np.intp)
        shaken = mixture is not None and mixture.vibrated and afferent is Afferent.PC
        if mixture is not None:
            everything = np.arange(len(mixture.time_us))
            which = everything if shaken else mixture.carried.get(afferent, which)
            pulse_s, drive = mixture.time_us[which] / 1e6, mixture.drive[which, afferent]
        else:
            pulse_s = drive = np.empty(0)
        rows[afferent] = ClassRow(answer.drive, pulse_s, drive.astype(np.float64), shaken)
    return color_figure(trace.time_s, trace.displacement_um, trace.force_n, rows, trace.title)
