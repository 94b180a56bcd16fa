"""Traces and spectra from CSV files."""

import math
from pathlib import Path

import numpy as np

from smarttouch.errors import SmartTouchError
from smarttouch.tables import CsvTable, read_csv
from smarttouch.vibrotactile.trace import HIGHEST_SAMPLE_HZ, SAMPLE_HZ, Trace, sampled

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
        "displacement_um or force_n, or frequency_hz and amplitude_um",
        about="columns",
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
