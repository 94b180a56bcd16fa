"""Traces of force and displacement on the skin, from a line of text, a file or samples.

A line of text is like ``tone:30Hz,8um+press:0.5N``.

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
from numpy.typing import ArrayLike, NDArray

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.tables import CsvTable, read_csv

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

    def __post_init__(self) -> None:
        if self.displacement_um.shape != self.force_n.shape or self.displacement_um.ndim != 1:
            raise SmartTouchError(
                f"a trace of {self.displacement_um.shape} displacements and {self.force_n.shape} "
                "forces: give as many of both, in one row"
            )
        if len(self.force_n) < 2:
            raise SmartTouchError(f"{self.title} has {len(self.force_n)} samples: give two or more")
        if not (np.isfinite(self.displacement_um).all() and np.isfinite(self.force_n).all()):
            raise SmartTouchError(
                f"{self.title} has a sample that is not a finite number: leave such samples out"
            )
        if self.duration_s > LONGEST_S:
            raise _too_long(self.title, self.duration_s)

    @property
    def duration_s(self) -> float:
        return len(self.force_n) / self.sample_hz

    @property
    def time_s(self) -> Array:
        """Time of each sample, (N,) s."""
        return np.asarray(np.arange(len(self.force_n)) / self.sample_hz)


def sampled(
    time_s: ArrayLike,  # (N,) s: rising; the first becomes 0
    displacement_um: ArrayLike | None = None,  # (N,) µm: into the skin; 0 if not given
    force_n: ArrayLike | None = None,  # (N,) N: 0 if not given
    title: str = "a trace",
) -> Trace:
    """Return the trace of unevenly timed samples, resampled evenly.

    Between samples it runs straight. The new rate is that of most samples, but
    between `SAMPLE_HZ` and `HIGHEST_SAMPLE_HZ`.
    """
    time = np.asarray(time_s, np.float64)
    nothing = np.zeros_like(time)
    rows = [
        nothing if row is None else np.asarray(row, np.float64)
        for row in (displacement_um, force_n)
    ]
    if len(time) < 2 or any(row.shape != time.shape for row in rows):
        raise SmartTouchError(
            f"{title} has {len(time)} times for {len(rows[0])} displacements and {len(rows[1])} "
            "forces: give as many of each, two or more"
        )
    steps = np.diff(time)
    if not (np.isfinite(time).all() and (steps > 0).all()):
        worst = int(np.argmin(np.where(np.isfinite(steps), steps, -math.inf)))
        raise SmartTouchError(
            f"{title}: times must rise, and sample {worst + 1} at {time[worst + 1]:g} s does not: "
            "sort them and give each once"
        )
    if time[-1] - time[0] > LONGEST_S:
        raise _too_long(title, float(time[-1] - time[0]))
    sample_hz = float(np.clip(1 / np.median(steps), SAMPLE_HZ, HIGHEST_SAMPLE_HZ))
    count = max(2, round((time[-1] - time[0]) * sample_hz) + 1)
    even = time[0] + np.arange(count) / sample_hz
    displacement, force = (np.interp(even, time, row) for row in rows)
    return Trace(displacement, force, sample_hz, title)


def _too_long(title: str, seconds: float) -> SmartTouchError:
    message = f"{title} lasts {seconds:g} s: at most {LONGEST_S:g}, cut it"
    return SmartTouchError(message)


_TIME, _DISPLACEMENT, _FORCE = "time_s", "displacement_um", "force_n"
_SPECTRUM, _PHASE = ("frequency_hz", "amplitude_um"), "phase_deg"
_SAMPLES_A_CYCLE = 4


def read_trace(path: Path, seconds: float, seed: int) -> Trace:
    """Return the trace in a CSV file.

    Its columns are ``time_s`` with ``displacement_um``, ``force_n`` or both; or a spectrum:
    ``frequency_hz``, ``amplitude_um`` and perhaps ``phase_deg``, drawn by the seed if missing,
    which lasts as long as asked for.
    """
    table = read_csv(path, SmartTouchError)
    beside = [name for name in (_DISPLACEMENT, _FORCE) if name in table.head]
    if _TIME in table.head and beside:
        values = dict(zip((_TIME, *beside), table.numbers((_TIME, *beside)).T, strict=True))
        return sampled(values[_TIME], values.get(_DISPLACEMENT), values.get(_FORCE), str(path))
    if set(_SPECTRUM) <= set(table.head):
        return _from_spectrum(table, seconds, seed)
    raise SmartTouchError(
        f"{path} has the columns {', '.join(table.head) or 'none'}: name them time_s and "
        "displacement_um or force_n, or frequency_hz and amplitude_um"
    )


def _from_spectrum(table: CsvTable, seconds: float, seed: int) -> Trace:
    names = [*_SPECTRUM, *([_PHASE] if _PHASE in table.head else [])]
    frequency, amplitude, *phases = table.numbers(names, fewest=1, rising=False).T
    highest = HIGHEST_SAMPLE_HZ / _SAMPLES_A_CYCLE
    for row in np.flatnonzero((frequency < 0) | (frequency > highest) | (amplitude < 0)):
        words = (
            f"{amplitude[row]:g} µm at {frequency[row]:g} Hz: give frequencies from 0 to "
            f"{highest:g} Hz and amplitudes that are not negative"
        )
        raise table.wrong(int(row), words)
    random = np.random.default_rng(seed)
    phase = phases[0] if phases else random.uniform(0, 360, len(frequency))
    sample_hz = max(SAMPLE_HZ, _SAMPLES_A_CYCLE * float(frequency.max()))
    time = np.arange(max(2, round(seconds * sample_hz))) / sample_hz
    total = np.zeros_like(time)
    for each_hz, each_um, each_deg in zip(frequency, amplitude, phase, strict=True):
        total += each_um * np.cos(2 * math.pi * each_hz * time + math.radians(each_deg))
    return Trace(total, np.zeros_like(total), sample_hz, str(table.path))


RAMP_S = 0.05  # rise and fall of each part, half a period of a cosine; our own choice
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
        raise SmartTouchError(message)
    if not is_spec(text):
        if not Path(text).exists():
            message = f"{text!r} is neither a file nor a trace in a line: {_EXAMPLE}"
            raise SmartTouchError(message)
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
        raise SmartTouchError(f"{text.strip()!r} is no part of a trace: {_EXAMPLE}")
    if not start_s < end_s <= seconds:
        raise SmartTouchError(
            f"{text.strip()!r} lasts from {start_s:g} to {end_s:g} s, the trace {seconds:g} s: "
            "let it end after it begins, or make the trace longer"
        )
    values = tuple(float(each) for each in matched.groups())
    band = values[:-1]
    if any(not 0 < each <= HIGHEST_HZ for each in band) or sorted(set(band)) != list(band):
        raise SmartTouchError(
            f"{text.strip()!r}: frequencies must be above 0, at most {HIGHEST_HZ:g} Hz, and the "
            "lower one first"
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
            "widen it, or make the trace longer"
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
