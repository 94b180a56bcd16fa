"""Vibration thresholds of each class of receptor by frequency.

The curves of the paper's Fig. 2 as analytic functions. In log-log coordinates RA and PC are
hyperbolas with a minimum at the best frequency; SAI is flat up to a few hertz. Sources:

- Best frequencies and bands: the paper (Sections I and III-C). RA is best at 30 Hz and responds
  from 20 to 70 Hz; PC is best at 250 Hz and responds from 60 to 800 Hz; SAI is static. At the edges
  of its band, RA's threshold is 3 dB above the minimum. PC's thresholds at 60 and 800 Hz are equal.
- Intersection: on the fingertip, RA and PC have equal thresholds at 40 Hz (Güçlü and Bolanowski).
  The paper's bands, which overlap from 60 to 70 Hz, are from other skin.
- Slopes: the four-channel model (Bolanowski, Gescheider, Verrillo and Checkosky, J. Acoust. Soc.
  Am. 84, 1988). Below the best frequency, the slope is about -12 dB per octave for the Pacinian
  channel (PC) and about -5 dB per octave for NP I (RA). NP III (SAI) has no such slope.
- Minima: PC has -10 dB re 1 µm for a contactor of 0.3 cm² on a finger pad. This is extrapolated
  from -20 dB for 2.9 cm² on the thenar (Bolanowski et al.), plus 3 dB for each halving of the area
  (Verrillo, J. Acoust. Soc. Am. 35, 1963). On the fingertip, these 3 dB are confirmed only from
  0.025 to 0.1 cm² (Gescheider 2002). SAI has 28 dB (Bolanowski et al.). RA's minimum follows from
  the intersection with PC.

With these parameters, RA and SAI intersect at about 5 Hz. Recordings from human afferents confirm
the order SAI, RA (8 to 64 Hz), PC (Johansson, Landström and Lundström, Brain Res. 244, 1982).
The curvature at the minimum is our choice. These are thresholds of perception; a single
afferent needs stronger vibration (`examples/studies/receptor_spikes.py`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smarttouch.base.afferent import Afferent

Array = NDArray[np.float64]

RA_BEST_HZ, RA_BAND_HZ = 30.0, (20.0, 70.0)
PC_BEST_HZ, PC_BAND_HZ = 250.0, (60.0, 800.0)
"""Best frequency and band of PC (paper, Section III-C)."""
BAND_DB = 3.0
"""RA's threshold at the edges of its band, dB above the minimum (our choice)."""
MEETING_HZ = 40.0
"""Frequency at which RA and PC have equal thresholds on the fingertip (Güçlü and Bolanowski)."""
PC_BEST_DB, SAI_DB = -10.0, 28.0
"""Minimum thresholds, dB re 1 µm amplitude; sources in the module's docstring."""
SAI_CORNER_HZ = 5.0
"""Corner frequency (our choice) above which SAI's threshold rises by 6 dB per octave."""
PC_DB_PER_OCTAVE = 12.0
"""Slope of PC's threshold (Bolanowski et al. 1988)."""


@dataclass(frozen=True)
class _CurveSide:
    """One side of a threshold curve."""

    db_per_octave: float
    roundness: float

    def rise_db(self, octaves: Array) -> Array:
        """Return the rise above the minimum, dB, at ``octaves`` octaves from the best frequency."""
        w = self.roundness
        return np.asarray(self.db_per_octave * (np.hypot(octaves, w) - w))


def _side_through(frequency_hz: float, best_hz: float, rise_db: float, round_: float) -> _CurveSide:
    octaves = abs(np.log2(frequency_hz / best_hz))
    return _CurveSide(float(rise_db / (np.hypot(octaves, round_) - round_)), round_)


@dataclass(frozen=True)
class _ThresholdCurve:
    """Threshold curve with one best frequency."""

    best_hz: float
    best_db: float
    below: _CurveSide
    above: _CurveSide

    def threshold_db(self, frequency_hz: Array) -> Array:
        octaves = np.log2(frequency_hz / self.best_hz)
        rise = np.where(octaves < 0, self.below.rise_db(octaves), self.above.rise_db(octaves))
        return np.asarray(self.best_db + rise)


def _threshold_curves() -> dict[Afferent, _ThresholdCurve]:
    pc_below = _CurveSide(PC_DB_PER_OCTAVE, 0.5)
    edge_db = float(pc_below.rise_db(np.log2(np.array(PC_BAND_HZ[0] / PC_BEST_HZ))))
    pc = _ThresholdCurve(
        PC_BEST_HZ, PC_BEST_DB, pc_below, _side_through(PC_BAND_HZ[1], PC_BEST_HZ, edge_db, 0.5)
    )
    # The threshold rises by 6.1 dB per octave far below 30 Hz, and by 8.7 dB far above.
    below, above = (
        _side_through(edge_hz, RA_BEST_HZ, BAND_DB, round_)
        for edge_hz, round_ in zip(RA_BAND_HZ, (0.1, 2.0), strict=True)
    )
    meeting = np.array(MEETING_HZ)
    rise_db = above.rise_db(np.log2(meeting / RA_BEST_HZ))
    ra = _ThresholdCurve(RA_BEST_HZ, float(pc.threshold_db(meeting) - rise_db), below, above)
    return {Afferent.RA: ra, Afferent.PC: pc}


_CURVES = _threshold_curves()


def threshold_um(afferent: Afferent, frequency_hz: ArrayLike) -> Array:
    """Return the threshold amplitude of a class, µm, at a frequency, Hz.

    The amplitude is half of peak to peak. 0 Hz is a static indentation, to which RA and PC never
    respond. Raises ValueError for negative frequencies.
    """
    frequency = np.asarray(frequency_hz, np.float64)
    if np.any(frequency < 0):
        raise ValueError(f"frequency {frequency.min():g} Hz is negative: give 0 or more")
    if afferent is Afferent.SAI:
        return np.asarray(10 ** (SAI_DB / 20) * np.hypot(1, frequency / SAI_CORNER_HZ))
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(10 ** (_CURVES[afferent].threshold_db(frequency) / 20))


def sensitivity(afferent: Afferent, frequency_hz: ArrayLike) -> Array:
    """Return the sensitivity at a frequency, Hz, relative to the sensitivity at the best frequency:
    30 Hz (RA), 250 Hz (PC) or 0 Hz (SAI)."""
    best = threshold_um(afferent, best_hz(afferent))
    return np.asarray(best / threshold_um(afferent, frequency_hz))


def best_hz(afferent: Afferent) -> float:
    """Return the frequency at which a class has its lowest threshold, Hz."""
    return 0.0 if afferent is Afferent.SAI else _CURVES[afferent].best_hz
