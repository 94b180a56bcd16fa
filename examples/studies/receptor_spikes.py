"""Spikes of a finger's afferents under a vibration or a press.

The same population that currents drive (`smarttouch.physiology.finger`), each afferent with a
threshold of its own. RA and PC follow the tuning of `smarttouch.physiology.vibration_thresholds`;
from where an afferent begins to fire to `LOCKED` times that amplitude its part of the cycles with a
spike rises from none to all, and each spike keeps to the phase of its cycle (as macaque afferents
do: Talbot, Darian-Smith, Kornhuber and Mountcastle, J. Neurophysiol. 31, 1968). SAI fires at a rate
that follows pressure. Away from what touches it the skin follows as an elastic half space does
beside a flat punch.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.instruments.skin_trace import (
    SAI_FULL_N,
    SAI_RATE_HZ,
    Array,
    Trace,
    cycles,
    pressed,
    turning,
)
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.vibration_thresholds import best_hz, threshold_um

AFFERENT_UM = {Afferent.RA: 30.0, Afferent.PC: 1.2}
"""Median amplitude at the class's best frequency at which an afferent begins to fire. Ours, after
TouchSim, where no RA of nine answers 30 Hz at 8 µm and some 45 µm are needed, and so that PC comes
in above RA at 30 Hz, as it does in feeling."""
DEEPER_MM = {Afferent.PC: 2.0}
"""Width that a stimulus gains on its way down to a class. Ours: as much as PC lies deep."""
LOCKED = 1.8
"""Amplitude of a spike in every cycle over that of the first spikes. Ours."""
SPREAD = 0.35
"""Standard deviation of the logarithm of thresholds and of SAI's rates between afferents. Ours."""
PROBE_MM = 1.0
"""Radius of what touches the skin, if not given. Ours."""


@dataclass(frozen=True, eq=False)
class SkinSpikes:
    """Spikes of afferents under a trace."""

    # (K,) int: number of the afferent of each spike, as in `Finger.classes`
    afferent: NDArray[np.intp]
    time_s: Array  # (K,), s
    counts: NDArray[np.intp]  # (A,): number of spikes of each afferent


def skin_spikes(
    finger: Finger,
    trace: Trace,  # what moves and presses the skin
    place_mm: tuple[float, float] = (0.0, 0.0),  # middle of what touches it
    radius_mm: float = PROBE_MM,  # its radius
    seed: int = 1,  # of thresholds and of the cycles that are left out
    # sai_full_n, sai_rate_hz: force at which SAI is driven in full, and its rate then
    sai_full_n: float = SAI_FULL_N,
    sai_rate_hz: float = SAI_RATE_HZ,
) -> SkinSpikes:
    """Return the spikes that a vibration or press gives the afferents of a finger.

    Examples
    --------
    >>> import smarttouch as st
    >>> from smarttouch.physiology.finger import Finger
    >>> from studies.receptor_spikes import skin_spikes
    >>> from smarttouch.instruments.skin_trace import open_trace
    >>> finger = Finger(st.load_profile("smarttouch-4x4"), seed=1, anatomy="paper")
    >>> spikes = skin_spikes(finger, open_trace("tone:30Hz,8um", 1.0))
    >>> int(spikes.counts[finger.classes == st.Afferent.RA].max())
    0
    """
    random = np.random.default_rng([seed, finger.seed])
    away = np.linalg.norm(finger.receptor_mm - np.asarray(place_mm), axis=1)
    gained = np.array([DEEPER_MM.get(each, 0.0) for each in Afferent])[finger.classes]
    wide = np.minimum(1, (radius_mm + gained) / np.maximum(away, 1e-9))
    follows = 2 / np.pi * np.arcsin(wide)
    follows *= np.exp(-random.normal(0, SPREAD, len(away)))
    found = [(np.zeros(0, np.intp), np.zeros(0))]
    for afferent in Afferent:
        mine = np.flatnonzero(finger.classes == afferent)
        if not len(mine):
            continue
        if afferent is Afferent.SAI:
            rate_hz = pressed(trace, sai_full_n, sai_rate_hz).rate_hz
            due = np.cumsum(rate_hz) / trace.sample_hz
            for each in mine:
                turn = np.floor(due * follows[each] + random.random())
                at = np.flatnonzero(np.diff(turn, prepend=turn[0]))
                found.append((np.full(len(at), each), at / trace.sample_hz))
        else:
            wave = turning(trace, afferent)
            wave *= threshold_um(afferent, best_hz(afferent)) / AFFERENT_UM[afferent]
            most = float(follows[mine].max())
            at_sample = cycles(wave, np.abs(wave) * most > 1, trace)
            level = np.abs(wave)[np.minimum(at_sample.astype(np.intp), len(wave) - 1)]
            part = (follows[mine, None] * level - 1) / (LOCKED - 1)
            who, which = np.nonzero(random.random(part.shape) < part)
            found.append((mine[who], at_sample[which] / trace.sample_hz))
    numbers, times = (np.concatenate(each) for each in zip(*found, strict=True))
    return SkinSpikes(numbers, times, np.bincount(numbers, minlength=len(away)))
