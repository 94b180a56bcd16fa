"""Spikes of a simulated finger's afferents during vibration and pressure.

The afferents are those of `smarttouch.physiology.finger`, each with a threshold of its own. RA and
PC are tuned as in `smarttouch.physiology.vibration_thresholds`. Above the threshold amplitude of an
afferent, the share of cycles with a spike increases linearly, up to 1 at `LOCKED` times the
threshold. Spikes are locked to the phase of a cycle, as in macaques (Talbot, Darian-Smith,
Kornhuber and Mountcastle, J. Neurophysiol. 31, 1968). The rate of SAI follows pressure. Around the
probe, the skin moves like an elastic half space beside a flat punch.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.instruments.vibration_trace import (
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
"""Median threshold amplitude of each class at its best frequency, 30 Hz for RA (our choice). In
TouchSim, none of nine RA afferents responds to 8 µm at 30 Hz; about 45 µm are needed."""
DEEPER_MM = {Afferent.PC: 2.0}
"""Increase of the radius of a stimulus from the surface to the depth of PC (our choice)."""
LOCKED = 1.8
"""Amplitude at which each cycle causes a spike, relative to the threshold (our choice)."""
SPREAD = 0.35
"""Standard deviation of the logarithms of RA and PC thresholds and SAI rates (our choice)."""
PROBE_MM = 1.0
"""Default radius of the probe that touches the skin (our choice)."""


@dataclass(frozen=True, eq=False)
class SkinSpikes:
    """Spikes of afferents during a trace of vibration and pressure."""

    # (K,) int: index of the afferent of each spike, as in `Finger.classes`
    afferent: NDArray[np.intp]
    time_s: Array  # (K,), s: time of each spike
    counts: NDArray[np.intp]  # (A,): number of spikes of each afferent


def skin_spikes(
    finger: Finger,
    trace: Trace,  # displacement and force of the probe
    place_mm: tuple[float, float] = (0.0, 0.0),  # center of the probe
    radius_mm: float = PROBE_MM,  # radius of the probe
    seed: int = 1,  # seed of thresholds, of SAI rates and phases, and of cycles without a spike
    sai_full_n: float = SAI_FULL_N,  # force at which the drive of SAI is 1
    sai_rate_hz: float = SAI_RATE_HZ,  # rate of SAI at this force
) -> SkinSpikes:
    """Return the spikes of a finger's afferents during a trace of vibration and pressure.

    Examples
    --------
    >>> import smarttouch as st
    >>> from smarttouch.physiology.finger import Finger
    >>> from studies.receptor_spikes import skin_spikes
    >>> from smarttouch.instruments.vibration_trace import open_trace
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
