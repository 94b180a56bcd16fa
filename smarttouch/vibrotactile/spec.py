"""Traces in one line of text: ``tone:30Hz,8um+press:0.5N``.

Parts are added up. Each begins and ends smoothly, within `RAMP_S`, as no skin can jump;
``@1-2`` after a part lets it last from 1 to 2 s, else it lasts all the time::

    tone:250Hz,2um            a sinusoid, amplitude as half of peak to peak
    sweep:5-500Hz,10um        a tone that rises, in equal times by equal ratios
    noise:60-400Hz,3um        Gaussian noise of a band, amplitude as root mean square
    press:0.5N                pressure
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smarttouch.errors import SmartTouchError
from smarttouch.vibrotactile.files import read_trace
from smarttouch.vibrotactile.trace import LONGEST_S, SAMPLE_HZ, Array, Trace

RAMP_S = 0.05
"""Rise and fall of each part, half a period of a cosine. Ours."""
HIGHEST_HZ = 1000.0
_NUMBER = r"(\d+(?:\.\d*)?|\.\d+)"
_BAND = rf"{_NUMBER}-{_NUMBER}hz"
_AMPLITUDE = rf"{_NUMBER}(?:um|µm|μm)"
_GRAMMAR = {
    "tone": re.compile(rf"{_NUMBER}hz,{_AMPLITUDE}"),
    "sweep": re.compile(rf"{_BAND},{_AMPLITUDE}"),
    "noise": re.compile(rf"{_BAND},{_AMPLITUDE}"),
    "press": re.compile(rf"{_NUMBER}n"),
}
_WHEN = re.compile(rf"@{_NUMBER}-{_NUMBER}s?$")
_EXAMPLE = "write for example tone:30Hz,8um+press:0.5N, or noise:60-400Hz,3um@0.5-1.5"


@dataclass(frozen=True)
class _Part:
    kind: str
    values: tuple[float, ...]
    start_s: float
    end_s: float


def is_spec(text: str) -> bool:
    """Return whether a text is a trace in one line, and no file."""
    return text.partition(":")[0].strip().lower() in _GRAMMAR


def open_trace(text: str, seconds: float = 2.0, seed: int = 0) -> Trace:
    """Return the trace of a line in this module's syntax, or of a CSV file.

    `seconds` is the duration of a line or a spectrum, a recorded trace has its own; the seed is of
    noise, and of phases that are not given.
    """
    if not 0 < seconds <= LONGEST_S:
        message = f"{seconds:g} s are not possible: above 0, at most {LONGEST_S:g}"
        raise SmartTouchError(message, about="seconds")
    if not is_spec(text):
        if not Path(text).exists():
            message = f"{text!r} is neither a file nor a trace in a line: {_EXAMPLE}"
            raise SmartTouchError(message, about="trace")
        return read_trace(Path(text), seconds, seed)
    random = np.random.default_rng(seed)
    time = np.arange(max(2, round(seconds * SAMPLE_HZ))) / SAMPLE_HZ
    displacement, force = np.zeros_like(time), np.zeros_like(time)
    for each in text.split("+"):
        part = _parse(each, seconds)
        wave = _WAVES[part.kind](part, time - part.start_s, random)
        total = force if part.kind == "press" else displacement
        total += wave * _window(time, part)
    return Trace(displacement, force, SAMPLE_HZ, text)


def _parse(text: str, seconds: float) -> _Part:
    said = text.strip().lower().replace(" ", "")
    start_s, end_s = 0.0, seconds
    when = _WHEN.search(said)
    if when:
        start_s, end_s = float(when[1]), float(when[2])
        said = said[: when.start()]
    kind, _, rest = said.partition(":")
    matched = _GRAMMAR[kind].fullmatch(rest) if kind in _GRAMMAR else None
    if matched is None:
        raise SmartTouchError(f"{text.strip()!r} is no part of a trace: {_EXAMPLE}", about="trace")
    if not start_s < end_s <= seconds:
        raise SmartTouchError(
            f"{text.strip()!r} lasts from {start_s:g} to {end_s:g} s, the trace {seconds:g} s: "
            "let it end after it begins, or make the trace longer",
            about="trace",
            remedy="seconds",
        )
    values = tuple(float(each) for each in matched.groups())
    band = values[:-1]
    if any(not 0 < each <= HIGHEST_HZ for each in band) or sorted(set(band)) != list(band):
        raise SmartTouchError(
            f"{text.strip()!r}: frequencies must be above 0, at most {HIGHEST_HZ:g} Hz, and the "
            "lower one first",
            about="frequency",
        )
    return _Part(kind, values, start_s, end_s)


def _window(time: Array, part: _Part) -> Array:
    """Return 1 while a part lasts, with smooth ends, (N,)."""
    ramp_s = min(RAMP_S, (part.end_s - part.start_s) / 2)
    to_edge = np.minimum(time - part.start_s, part.end_s - time) / ramp_s
    return np.asarray((1 - np.cos(math.pi * np.clip(to_edge, 0, 1))) / 2)


def _tone(part: _Part, time: Array, random: np.random.Generator) -> Array:
    frequency_hz, amplitude_um = part.values
    return np.asarray(amplitude_um * np.sin(2 * math.pi * frequency_hz * time))


def _sweep(part: _Part, time: Array, random: np.random.Generator) -> Array:
    low_hz, high_hz, amplitude_um = part.values
    octaves_s = math.log(high_hz / low_hz) / (part.end_s - part.start_s)
    within = np.clip(time, 0, part.end_s - part.start_s)
    cycles = low_hz / octaves_s * np.expm1(octaves_s * within)
    return np.asarray(amplitude_um * np.sin(2 * math.pi * cycles))


def _noise(part: _Part, time: Array, random: np.random.Generator) -> Array:
    low_hz, high_hz, rms_um = part.values
    spectrum = np.fft.rfft(random.standard_normal(len(time)))
    frequency_hz = np.fft.rfftfreq(len(time), 1 / SAMPLE_HZ)
    spectrum[(frequency_hz < low_hz) | (frequency_hz > high_hz)] = 0
    wave = np.fft.irfft(spectrum, len(time))
    spread = wave.std()
    if not spread > 0:
        raise SmartTouchError(
            f"noise from {low_hz:g} to {high_hz:g} Hz is too narrow a band for so short a trace: "
            "widen it, or make the trace longer",
            about="trace",
            remedy="seconds",
        )
    return np.asarray(wave * (rms_um / spread))


def _press(part: _Part, time: Array, random: np.random.Generator) -> Array:
    return np.full_like(time, part.values[0])


_WAVES: dict[str, Callable[[_Part, Array, np.random.Generator], Array]] = {
    "tone": _tone,
    "sweep": _sweep,
    "noise": _noise,
    "press": _press,
}
