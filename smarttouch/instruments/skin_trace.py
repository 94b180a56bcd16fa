"""Traces of force and displacement on the skin, from a line of text or a file.

A line of text is like ``tone:30Hz,8um+press:0.5N``. Its parts are added up, and all begin and end
smoothly, within `RAMP_S`, as no skin can jump::

    tone:250Hz,2um            a sinusoid, amplitude as half of peak to peak
    press:0.5N                pressure
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import read_csv

Array = NDArray[np.float64]

SAMPLE_HZ = 4000.0  # lowest sampling rate: four samples a cycle at 1 kHz, above PC's band
HIGHEST_SAMPLE_HZ = 20_000.0
LONGEST_S = 600.0


@dataclass(frozen=True, eq=False)
class Trace:
    """Force and displacement at one place of the skin, evenly sampled from time 0."""

    displacement_um: Array  # (N,) float64, µm: into the skin, from where it is at rest
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
    """Return the trace in a CSV file of ``time_s`` with ``displacement_um``, ``force_n`` or both.

    Between samples it runs straight. It is resampled at the rate of most samples, but between
    `SAMPLE_HZ` and `HIGHEST_SAMPLE_HZ`.
    """
    table = read_csv(path, SmartTouchError)
    beside = [name for name in (_DISPLACEMENT, _FORCE) if name in table.head]
    if not beside:
        raise SmartTouchError(
            f"{path} has the columns {', '.join(table.head) or 'none'}: name them time_s and "
            "displacement_um or force_n"
        )
    time, *columns = table.numbers((_TIME, *beside)).T
    lasts_s = float(time[-1] - time[0])
    if lasts_s > LONGEST_S:
        raise SmartTouchError(f"{path} lasts {lasts_s:g} s: at most {LONGEST_S:g}, cut it")
    sample_hz = float(np.clip(1 / np.median(np.diff(time)), SAMPLE_HZ, HIGHEST_SAMPLE_HZ))
    even = time[0] + np.arange(max(2, round(lasts_s * sample_hz) + 1)) / sample_hz
    rows = {
        name: np.interp(even, time, column) for name, column in zip(beside, columns, strict=True)
    }
    nothing = np.zeros_like(even)
    displacement, force = (rows.get(name, nothing) for name in (_DISPLACEMENT, _FORCE))
    return Trace(displacement, force, sample_hz, str(path))


RAMP_S = 0.05  # rise and fall of each part, half a period of a cosine; our own choice
HIGHEST_HZ = 1000.0
_NUMBER = r"(\d+(?:\.\d*)?|\.\d+)"
_AMPLITUDE = rf"{_NUMBER}(?:um|µm|μm)"
_GRAMMAR = {
    "tone": re.compile(rf"{_NUMBER}hz,{_AMPLITUDE}"),
    "press": re.compile(rf"{_NUMBER}n"),
}
_EXAMPLE = "write for example tone:30Hz,8um+press:0.5N"


def open_trace(text: str, seconds: float = 2.0) -> Trace:
    """Return the trace of a line in this module's syntax, or of a CSV file.

    `seconds` is the duration of a line; a recorded trace has its own.
    """
    if not 0 < seconds <= LONGEST_S:
        message = f"{seconds:g} s are not possible: above 0, at most {LONGEST_S:g}"
        raise SmartTouchError(message)
    if text.partition(":")[0].strip().lower() not in _GRAMMAR:
        if not Path(text).exists():
            message = f"{text!r} is neither a file nor a trace in a line: {_EXAMPLE}"
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
    """Return the kind of a part and its numbers: a frequency and an amplitude, or a force."""
    kind, _, rest = text.strip().lower().replace(" ", "").partition(":")
    matched = _GRAMMAR[kind].fullmatch(rest) if kind in _GRAMMAR else None
    if matched is None:
        raise SmartTouchError(f"{text.strip()!r} is no part of a trace: {_EXAMPLE}")
    values = [float(number) for number in matched.groups()]
    if kind == "tone" and not 0 < values[0] <= HIGHEST_HZ:
        raise SmartTouchError(
            f"{text.strip()!r}: a frequency must be above 0 and at most {HIGHEST_HZ:g} Hz"
        )
    return kind, values
