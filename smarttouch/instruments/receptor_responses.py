"""Splitting of a vibration into the responses of each class of receptor.

RA and PC see the displacement through their sensitivity
(`smarttouch.physiology.vibration_thresholds`), in units of their threshold, by a filter without
delay (all of the trace is known beforehand). Two things are read from its analytic signal: its
envelope, how far above threshold, and its phase, whose turns are the cycles of the vibration. In
their band both fire one spike each cycle (Talbot, Darian-Smith, Kornhuber and Mountcastle, J.
Neurophysiol. 31, 1968; Johansson, Landström and Lundström, Brain Res. 244, 1982), and the rate at
which those under the stimulus fire grows with the logarithm of amplitude (Muniak, Ray, Hsiao,
Dammann and Bensmaia, J. Neurosci. 27, 2007): so drive is linear in decibels above threshold.

SAI sees pressure, and indentation below a few hertz. Its drive is linear in both, as the
firing of SAI afferents is in compressive stress (rat: Ge and Khalsa, J. Neurophysiol. 87,
2002); its rate follows (paper, Section III-B.2).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import ifft, irfft, next_fast_len, rfft

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.instruments.skin_trace import Array, Trace
from smarttouch.physiology.vibration_thresholds import sensitivity, threshold_um
from smarttouch.stimulation.pulse_rates import SLOWEST

SPAN_DB = 5.0
"""From threshold to a drive of 1. Ours: a tone of 30 Hz that far above RA's threshold just reaches
PC's, so that RA alone can be driven in full; it is also about where an afferent that begins to
fire does so in each cycle."""
SAI_FORCE_N = 0.0013
"""Median force at which human SAI afferents begin to fire (Johansson, Vallbo and Westling, Brain
Res. 184, 1980)."""
SAI_FULL_N = 1.0  # force at which SAI is driven in full, if no profile is given; our own choice
SAI_FULL_UM = 1500.0
"""Indentation up to which SAI afferents fire faster (J. Neurophysiol. 101:1033, 2009, Table 1)."""
SAI_RATE_HZ = 50.0
"""Rate at full drive without a profile, the usual ``pulse.sai_rate_hz``; at the lightest touch
a fifth of it."""
_PAD_S = 1.0
"""Padding that joins the trace's end to its beginning, as the Fourier transform is cyclic."""
_GAP_S = 0.05  # longest silence between two beats of one vibration


@dataclass(frozen=True, eq=False)
class ReceptorResponse:
    """Response of one class to a trace."""

    afferent: Afferent
    # (N,) float64, in [0, 1]: drive at each sample of the trace: 0 at threshold and below
    drive: Array
    rate_hz: Array  # (N,) float64, Hz: firing rate of its afferents
    spike_s: Array  # (K,) float64, s: when


def split_trace(
    trace: Trace,
    sai_full_n: float = SAI_FULL_N,  # force at which SAI is driven in full
    sai_rate_hz: float = SAI_RATE_HZ,  # at which it then fires
) -> dict[Afferent, ReceptorResponse]:
    """Return the response of each class."""
    if not sai_full_n > SAI_FORCE_N:
        raise ScheduleError(
            f"full force at {sai_full_n:g} N is no more than the {SAI_FORCE_N:g} N at which SAI "
            "begins to answer: raise force.full_n of the profile"
        )
    return {
        Afferent.RA: _vibration(trace, Afferent.RA),
        Afferent.SAI: pressed(trace, sai_full_n, sai_rate_hz),
        Afferent.PC: _vibration(trace, Afferent.PC),
    }


def turning(trace: Trace, afferent: Afferent) -> NDArray[np.complex128]:
    """Return the vibration as a class sees it, in units of its threshold: an analytic signal."""
    padded, first, frequency_hz = _padded(trace.displacement_um, trace.sample_hz)
    gain = 1 / threshold_um(afferent, frequency_hz)
    half = np.zeros(len(padded), np.complex128)
    half[: len(gain)] = 2 * rfft(padded) * gain
    return np.asarray(ifft(half)[first : first + len(trace.force_n)])


def cycles(wave: NDArray[np.complex128], driven: NDArray[np.bool_], trace: Trace) -> Array:
    """Return the samples at which each cycle of `turning` begins while driven."""
    return _upward(wave, driven, round(_GAP_S * trace.sample_hz))


def _vibration(trace: Trace, afferent: Afferent) -> ReceptorResponse:
    wave = turning(trace, afferent)
    with np.errstate(divide="ignore"):
        drive = np.clip(20 * np.log10(np.abs(wave)) / SPAN_DB, 0, 1)
    spike_s = cycles(wave, drive > 0, trace) / trace.sample_hz
    return ReceptorResponse(afferent, drive, _rate_hz(spike_s, trace, drive), spike_s)


def pressed(trace: Trace, full_n: float, rate_hz: float) -> ReceptorResponse:
    """Return the response of SAI, driven in full at a force and then firing at a rate."""
    drives = []
    rows = (
        (trace.force_n, SAI_FORCE_N, full_n),
        (trace.displacement_um, float(threshold_um(Afferent.SAI, 0)), SAI_FULL_UM),
    )
    for row, faintest, full in rows:
        padded, first, frequency_hz = _padded(row, trace.sample_hz)
        slow = irfft(rfft(padded) * sensitivity(Afferent.SAI, frequency_hz), len(padded))
        drives.append((slow[first : first + len(row)] - faintest) / (full - faintest))
    drive = np.clip(np.maximum(*drives), 0, 1)
    firing_hz = np.where(drive > 0, rate_hz * np.maximum(SLOWEST, drive), 0.0)
    due = np.cumsum(firing_hz) / trace.sample_hz
    # A first spike as soon as it is touched.
    spike = np.flatnonzero(np.diff(np.ceil(due), prepend=0.0) > 0)
    return ReceptorResponse(Afferent.SAI, drive, firing_hz, spike / trace.sample_hz)


def _padded(row: Array, sample_hz: float) -> tuple[Array, int, Array]:
    """Return a row padded to a cycle, its offset in it, and the cycle's frequencies."""
    pad = round(_PAD_S * sample_hz)
    length = next_fast_len(len(row) + 2 * pad)
    joint = length - len(row)
    turn = (1 - np.cos(np.linspace(0, math.pi, joint))) / 2
    closed = np.concatenate([row, row[-1] + (row[0] - row[-1]) * turn])
    return np.roll(closed, pad), pad, np.asarray(np.fft.rfftfreq(length, 1 / sample_hz))


def _upward(turning: NDArray[np.complex128], driven: NDArray[np.bool_], gap: int) -> Array:
    """Return the samples of upward zero crossings of the real part while driven, once per cycle,
    counted on through silences of up to ``gap`` samples."""
    turns = (np.unwrap(np.angle(turning)) + math.pi / 2) / (2 * math.pi)
    whole = np.floor(turns).astype(np.int64)
    on = np.flatnonzero(driven)
    if not len(on):
        return np.empty(0)
    # Where it trembles back over zero the turn has been counted: only new heights count, stretch
    # by stretch, each set off above the one before.
    starts = on[np.diff(on, prepend=-gap - 1) > gap]
    stretch = np.cumsum(np.bincount(starts, minlength=len(driven))) - 1
    height = whole - whole[starts][stretch] + stretch * (2 * len(driven))
    highest = np.maximum.accumulate(height)
    at = np.flatnonzero((np.diff(highest) > 0) & driven[:-1] & driven[1:])
    step = turns[at + 1] - turns[at]
    return np.asarray(at + np.clip((whole[at + 1] - turns[at]) / step, 0, 1))


def _rate_hz(spike_s: Array, trace: Trace, drive: Array) -> Array:
    """Return the rate between successive spikes at each sample where a class is driven, (N,) Hz."""
    if len(spike_s) < 2:
        return np.zeros_like(drive)
    between = 1 / np.diff(spike_s)
    index = np.searchsorted(spike_s, trace.time_s, side="right") - 1
    return np.where(drive > 0, between[np.clip(index, 0, len(between) - 1)], 0.0)
