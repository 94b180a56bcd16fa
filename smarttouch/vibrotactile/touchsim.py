"""Rates of a finger's afferents under three stimuli, beside those of TouchSim.

TouchSim (Saal, Delhaye, Rayhaun and Bensmaia 2017) models afferents of the hand under mechanical
stimuli, fitted to recordings from macaques. Its figures here are those of one run on the same
stimuli; it is not needed to make this table.
"""

from collections.abc import Sequence

import numpy as np

from smarttouch.afferent import Afferent
from smarttouch.physiology.finger import Finger
from smarttouch.vibrotactile.afferents import skin_spikes
from smarttouch.vibrotactile.spec import open_trace

_SECONDS = 1.0
_NINE = 9
_FORCE_N, _FULL_N = 0.45, 0.9
_AMPLITUDES_UM = (15, 20, 25, 30, 35, 40, 45, 50, 60, 70, 80)


def nearest_hz(finger: Finger, spec: str, afferent: Afferent, count: int) -> list[float]:
    """Return the rates of the nearest afferents of a class under a stimulus in the middle, Hz."""
    mine = np.flatnonzero(finger.classes == afferent)
    mine = mine[np.linalg.norm(finger.receptor_mm[mine], axis=1).argsort()[:count]]
    spikes = skin_spikes(finger, open_trace(spec, _SECONDS), sai_full_n=_FULL_N)
    return [float(each) for each in spikes.counts[mine] / _SECONDS]


def touchsim_rows(fingers: Sequence[Finger]) -> list[tuple[str, str, str, str]]:
    """Return rows of stimulus, TouchSim's answer, source, and that of fingers, means over them."""

    def answering(um: float) -> float:
        spec = f"tone:30Hz,{um:g}um"
        rates = [nearest_hz(one, spec, Afferent.RA, _NINE) for one in fingers]
        return float((np.array(rates) > 0).sum(axis=1).mean())

    needed = next((um for um in _AMPLITUDES_UM if answering(um) >= _NINE / 3), None)
    pressed = [nearest_hz(one, f"press:{_FORCE_N:g}N", Afferent.SAI, 3) for one in fingers]
    shaken = [nearest_hz(one, "tone:250Hz,1.5um", Afferent.PC, 1) for one in fingers]
    locked = np.mean([rate > 0 for (rate,) in shaken])
    return [
        ("30 Hz, 8 µm: RA of the nine nearest that answer", "0", "TouchSim", f"{answering(8):.1f}"),
        (
            "30 Hz: amplitude at which a third of them answer, µm",
            "some 45",
            "TouchSim",
            "above 80" if needed is None else f"{needed:g}",
        ),
        (
            "250 Hz, 1.5 µm: the nearest PC answers, part of fingers",
            "answers",
            "TouchSim",
            f"{locked:.0%}",
        ),
        (
            f"press of {_FORCE_N:g} N: rate of the three nearest SAI, Hz",
            "24",
            "TouchSim",
            f"{np.mean(pressed):.0f}, SD {np.mean(pressed, axis=1).std():.0f} between fingers",
        ),
    ]
