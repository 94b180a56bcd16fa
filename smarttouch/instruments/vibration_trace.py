"""Traces of force and displacement on the skin, and the responses of receptors.

A trace is given as a line of text such as ``tone:30Hz,8um+press:0.5N``, or as a CSV file. The parts
of a line are added up. The sum rises from zero and falls to zero within `RAMP_S`. Kinds of parts::

    tone:250Hz,2um            a sinusoid; the amplitude is half of the peak-to-peak value
    press:0.5N                constant force
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.fft import ifft, irfft, next_fast_len, rfft

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError, SmartTouchError
from smarttouch.base.files import read_csv
from smarttouch.physiology.vibration_thresholds import sensitivity, threshold_um
from smarttouch.stimulation.scheduler import SLOWEST

Array = NDArray[np.float64]

SAMPLE_HZ = 4000.0  # lowest sampling rate (PC, the fastest class, responds below 1 kHz)
HIGHEST_SAMPLE_HZ = 20_000.0
LONGEST_S = 600.0


@dataclass(frozen=True, eq=False)
class Trace:
    """Force and displacement at one place of the skin, sampled at a constant rate from time 0."""

    displacement_um: Array  # (N,) float64, µm: into the skin, from the resting position
    force_n: Array  # (N,) float64, N: static and slowly changing pressure
    sample_hz: float = SAMPLE_HZ
    title: str = "a trace"

    @property
    def duration_s(self) -> float:
        return len(self.force_n) / self.sample_hz

    @property
    def time_s(self) -> Array:
        """Time of each sample, (N,) s."""
        return np.asarray(np.arange(len(self.force_n)) / self.sample_hz)


_TIME, _DISPLACEMENT, _FORCE = "time_s", "displacement_um", "force_n"


def read_trace(path: Path) -> Trace:
    """Load a CSV file with column ``time_s``, and with ``displacement_um``, ``force_n`` or both.

    The trace is resampled by linear interpolation. The new rate is the median rate of the file,
    limited to the range from `SAMPLE_HZ` to `HIGHEST_SAMPLE_HZ`.
    """
    columns = read_csv(path, SmartTouchError, (_TIME,), (_DISPLACEMENT, _FORCE))
    time = columns.pop(_TIME)
    if not columns:
        raise SmartTouchError(
            f"{path} has only the column time_s: add a column displacement_um or force_n"
        )
    lasts_s = float(time[-1] - time[0])
    if lasts_s > LONGEST_S:
        raise SmartTouchError(f"{path} lasts {lasts_s:g} s: shorten it to {LONGEST_S:g} s or less")
    sample_hz = float(np.clip(1 / np.median(np.diff(time)), SAMPLE_HZ, HIGHEST_SAMPLE_HZ))
    even = time[0] + np.arange(max(2, round(lasts_s * sample_hz) + 1)) / sample_hz
    rows = {name: np.interp(even, time, column) for name, column in columns.items()}
    nothing = np.zeros_like(even)
    displacement, force = (rows.get(name, nothing) for name in (_DISPLACEMENT, _FORCE))
    return Trace(displacement, force, sample_hz, str(path))


RAMP_S = 0.05  # duration of the rise and of the fall, which have the shape of a cosine (our choice)
HIGHEST_HZ = 1000.0
_NUMBER = r"(\d+(?:\.\d*)?|\.\d+)"
_AMPLITUDE = rf"{_NUMBER}(?:um|µm|μm)"
_GRAMMAR = {
    "tone": re.compile(rf"{_NUMBER}hz,{_AMPLITUDE}"),
    "press": re.compile(rf"{_NUMBER}n"),
}
_EXAMPLE = "write for example tone:30Hz,8um+press:0.5N"


def open_trace(text: str, seconds: float = 2.0) -> Trace:
    """Return the trace given by a line such as ``tone:30Hz,8um``, or by the path of a CSV file.
    ``seconds`` is the duration if a line is given; a file states its duration."""
    if not 0 < seconds <= LONGEST_S:
        message = f"a trace cannot last {seconds:g} s: give more than 0, at most {LONGEST_S:g} s"
        raise SmartTouchError(message)
    if text.partition(":")[0].strip().lower() not in _GRAMMAR:
        if not Path(text).exists():
            message = f"{text!r} is neither a file nor a trace: {_EXAMPLE}"
            raise SmartTouchError(message)
        return read_trace(Path(text))
    time = np.arange(max(2, round(seconds * SAMPLE_HZ))) / SAMPLE_HZ
    displacement, force = np.zeros_like(time), np.zeros_like(time)
    for part in text.split("+"):
        kind, values = _parse(part)
        if kind == "press":
            force += values[0]
        else:
            displacement += values[1] * np.sin(2 * math.pi * values[0] * time)
    to_edge = np.minimum(time, seconds - time) / min(RAMP_S, seconds / 2)
    smooth = (1 - np.cos(math.pi * np.clip(to_edge, 0, 1))) / 2
    return Trace(displacement * smooth, force * smooth, SAMPLE_HZ, text)


def _parse(text: str) -> tuple[str, list[float]]:
    """Parse a part of a trace; return its kind and its numbers (frequency, amplitude, force)."""
    kind, _, rest = text.strip().lower().replace(" ", "").partition(":")
    matched = _GRAMMAR[kind].fullmatch(rest) if kind in _GRAMMAR else None
    if matched is None:
        raise SmartTouchError(f"{text.strip()!r} is not a part of a trace: {_EXAMPLE}")
    values = [float(number) for number in matched.groups()]
    if kind == "tone" and not 0 < values[0] <= HIGHEST_HZ:
        raise SmartTouchError(
            f"{text.strip()!r}: a frequency must be above 0 and at most {HIGHEST_HZ:g} Hz"
        )
    return kind, values


SPAN_DB = 5.0
"""Drive is full if a vibration is this much above the threshold of a class (our choice). At about
this level, an afferent begins to fire in each cycle."""
SAI_FORCE_N = 0.0013
"""Median threshold force of human SAI afferents (Johansson, Vallbo and Westling, Brain Res. 184,
1980)."""
SAI_FULL_N = 1.0  # default force of full SAI drive (our choice)
SAI_FULL_UM = 1500.0
"""Indentation at which the rate of SAI afferents saturates (J. Neurophysiol. 101:1033, 2009, Table
1)."""
SAI_RATE_HZ = 50.0
"""Default SAI rate at full drive. At the threshold, SAI fires at a fifth of this rate."""
_PAD_S = 1.0  # padding before and after a trace, because the Fourier transform is cyclic
_GAP_S = 0.05  # a vibration ends if it stays below the threshold for longer than this


@dataclass(frozen=True, eq=False)
class ReceptorResponse:
    """Response of one afferent class to a trace."""

    afferent: Afferent
    # (N,) float64: drive at each sample, from 0 (at or below the threshold) to 1
    drive: Array
    rate_hz: Array  # (N,) float64, Hz: firing rate of afferents
    spike_s: Array  # (K,) float64, s: times of spikes


def split_trace(
    trace: Trace,
    sai_full_n: float = SAI_FULL_N,  # force of full SAI drive
    sai_rate_hz: float = SAI_RATE_HZ,  # SAI firing rate at full drive
) -> dict[Afferent, ReceptorResponse]:
    """Return the response of each afferent class to a trace."""
    if not sai_full_n > SAI_FORCE_N:
        raise ScheduleError(
            f"full force at {sai_full_n:g} N is not above the {SAI_FORCE_N:g} N at which SAI "
            "begins to fire: raise force.full_n of the profile"
        )
    return {
        Afferent.RA: _vibration(trace, Afferent.RA),
        Afferent.SAI: pressed(trace, sai_full_n, sai_rate_hz),
        Afferent.PC: _vibration(trace, Afferent.PC),
    }


def turning(trace: Trace, afferent: Afferent) -> NDArray[np.complex128]:
    """Return the vibration relative to the threshold of a class, as an analytic signal."""
    padded, first, frequency_hz = _padded(trace.displacement_um, trace.sample_hz)
    gain = 1 / threshold_um(afferent, frequency_hz)
    half = np.zeros(len(padded), np.complex128)
    half[: len(gain)] = 2 * rfft(padded) * gain
    return np.asarray(ifft(half)[first : first + len(trace.force_n)])


def cycles(wave: NDArray[np.complex128], driven: NDArray[np.bool_], trace: Trace) -> Array:
    """Return the samples at which a cycle of an analytic signal begins while ``driven`` is True."""
    return _upward(wave, driven, round(_GAP_S * trace.sample_hz))


def _vibration(trace: Trace, afferent: Afferent) -> ReceptorResponse:
    wave = turning(trace, afferent)
    with np.errstate(divide="ignore"):
        drive = np.clip(20 * np.log10(np.abs(wave)) / SPAN_DB, 0, 1)
    spike_s = cycles(wave, drive > 0, trace) / trace.sample_hz
    return ReceptorResponse(afferent, drive, _rate_hz(spike_s, trace, drive), spike_s)


def pressed(trace: Trace, full_n: float, rate_hz: float) -> ReceptorResponse:
    """Return the response of SAI. At the force ``full_n``, drive is 1 and rate is ``rate_hz``."""
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
    # The first spike is at contact.
    spike = np.flatnonzero(np.diff(np.ceil(due), prepend=0.0) > 0)
    return ReceptorResponse(Afferent.SAI, drive, firing_hz, spike / trace.sample_hz)


def _padded(row: Array, sample_hz: float) -> tuple[Array, int, Array]:
    """Return a padded cyclic signal, the index at which the trace starts, and the frequencies."""
    pad = round(_PAD_S * sample_hz)
    length = next_fast_len(len(row) + 2 * pad)
    joint = length - len(row)
    turn = (1 - np.cos(np.linspace(0, math.pi, joint))) / 2
    closed = np.concatenate([row, row[-1] + (row[0] - row[-1]) * turn])
    return np.roll(closed, pad), pad, np.asarray(np.fft.rfftfreq(length, 1 / sample_hz))


def _upward(turning: NDArray[np.complex128], driven: NDArray[np.bool_], gap: int) -> Array:
    """Return one sample for each driven cycle: the sample at which the real part of ``turning``
    crosses zero upward. Fewer than ``gap`` undriven samples in a row do not end a stretch of driven
    samples."""
    turns = (np.unwrap(np.angle(turning)) + math.pi / 2) / (2 * math.pi)
    full_turns = np.floor(turns).astype(np.int64)
    on = np.flatnonzero(driven)
    if not len(on):
        return np.empty(0)
    # Jitter can make the phase cross zero several times in a cycle. So count a crossing only if the
    # phase is larger than all earlier phases. An offset makes all phases of a driven stretch larger
    # than those of earlier stretches, so that this condition compares only within the stretch.
    starts = on[np.diff(on, prepend=-gap - 1) > gap]
    stretch = np.cumsum(np.bincount(starts, minlength=len(driven))) - 1
    height = full_turns - full_turns[starts][stretch] + stretch * (2 * len(driven))
    highest = np.maximum.accumulate(height)
    at = np.flatnonzero((np.diff(highest) > 0) & driven[:-1] & driven[1:])
    step = turns[at + 1] - turns[at]
    return np.asarray(at + np.clip((full_turns[at + 1] - turns[at]) / step, 0, 1))


def _rate_hz(spike_s: Array, trace: Trace, drive: Array) -> Array:
    """Return the firing rate at each sample, (N,) Hz: 1 / spike interval, or 0 if not driven."""
    if len(spike_s) < 2:
        return np.zeros_like(drive)
    between = 1 / np.diff(spike_s)
    index = np.searchsorted(spike_s, trace.time_s, side="right") - 1
    return np.where(drive > 0, between[np.clip(index, 0, len(between) - 1)], 0.0)
