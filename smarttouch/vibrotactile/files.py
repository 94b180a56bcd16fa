"""Traces and spectra from CSV files."""

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smarttouch.errors import SmartTouchError
from smarttouch.files import read_text
from smarttouch.vibrotactile.trace import HIGHEST_SAMPLE_HZ, SAMPLE_HZ, Array, Trace, sampled

_TIME, _SPECTRUM = "time_s", "frequency_hz"
_BESIDE = {
    _TIME: ("displacement_um", "force_n"),
    _SPECTRUM: ("amplitude_um", "phase_deg"),
}
_SAMPLES_A_CYCLE = 4


@dataclass(frozen=True, eq=False)
class _Table:
    path: Path
    line: list[int]
    """Number of each row's line in the file."""
    columns: dict[str, Array]

    def error(self, row: int, what: str, problem: str) -> SmartTouchError:
        line = self.line[row]
        message = f"{self.path}, line {line}: {what}"
        return SmartTouchError(message, about="line", problem=problem, value=line)


def read_csv(path: Path, seconds: float, seed: int) -> Trace:
    """Return the trace in a file.

    Parameters
    ----------
    path : Path
        With a header: ``time_s`` and ``displacement_um``, ``force_n`` or both; or
        ``frequency_hz``, ``amplitude_um`` and perhaps ``phase_deg``, a spectrum.
    seconds : float, s
        How long a spectrum is to last.
    seed : int
        Of the phases of a spectrum that has none.

    Raises
    ------
    SmartTouchError
        If it cannot be read; with the number of the line.
    """
    table = _read(path)
    if _TIME in table.columns:
        return _over_time(table)
    return _from_spectrum(table, seconds, seed)


def _over_time(table: _Table) -> Trace:
    time = table.columns[_TIME]
    late = np.flatnonzero(np.diff(time) <= 0)
    if len(late):
        row = int(late[0]) + 1
        raise table.error(
            row,
            f"time_s {time[row]:g} is not after the {time[row - 1]:g} before it: sort the lines "
            "and give each time once",
            "falling",
        )
    displacement, force = (table.columns.get(name) for name in _BESIDE[_TIME])
    return sampled(time, displacement, force, str(table.path))


def _from_spectrum(table: _Table, seconds: float, seed: int) -> Trace:
    frequency, amplitude = table.columns[_SPECTRUM], table.columns["amplitude_um"]
    highest = HIGHEST_SAMPLE_HZ / _SAMPLES_A_CYCLE
    for row in np.flatnonzero((frequency < 0) | (frequency > highest) | (amplitude < 0)):
        raise table.error(
            int(row),
            f"{amplitude[row]:g} µm at {frequency[row]:g} Hz: give frequencies from 0 to "
            f"{highest:g} Hz and amplitudes that are not negative",
            "impossible",
        )
    phase = table.columns.get("phase_deg")
    if phase is None:
        phase = np.random.default_rng(seed).uniform(0, 360, len(frequency))
    sample_hz = max(SAMPLE_HZ, _SAMPLES_A_CYCLE * float(frequency.max()))
    time = np.arange(max(2, round(seconds * sample_hz))) / sample_hz
    total = np.zeros_like(time)
    for each_hz, each_um, each_deg in zip(frequency, amplitude, phase, strict=True):
        total += each_um * np.cos(2 * math.pi * each_hz * time + math.radians(each_deg))
    return Trace(total, np.zeros_like(total), sample_hz, str(table.path))


def _read(path: Path) -> _Table:
    try:
        reader = csv.reader(io.StringIO(read_text(path, SmartTouchError), newline=""))
        rows = [(number, row) for number, row in enumerate(reader, 1) if any(row)]
    except csv.Error:
        message = f"{path} is no CSV file: save it as comma-separated UTF-8"
        raise SmartTouchError(message, about="file", problem="malformed", value=path) from None
    (number, header), rows = rows[0] if rows else (1, []), rows[1:]
    names = [each.strip() for each in header]
    first = next((each for each in _BESIDE if each in names), "")
    beside = [each for each in _BESIDE.get(first, ()) if each in names]
    if not beside or beside == ["phase_deg"]:
        raise SmartTouchError(
            f"{path}, line {number}: the columns are {', '.join(names) or 'none'}: name them "
            "time_s and displacement_um or force_n, or frequency_hz and amplitude_um",
            about="columns",
            value=tuple(names),
            allowed=tuple(_BESIDE),
        )
    fewest = 2 if first == _TIME else 1
    if len(rows) < fewest:
        raise SmartTouchError(
            f"{path} has {len(rows)} rows of numbers: give {fewest} or more",
            about="rows",
            problem="too few",
            value=len(rows),
            allowed=fewest,
        )
    wanted = (first, *beside)
    places = [names.index(each) for each in wanted]
    values = np.array([[_number(path, line, row, at) for at in places] for line, row in rows])
    return _Table(path, [line for line, _ in rows], dict(zip(wanted, values.T, strict=True)))


def _number(path: Path, line: int, row: list[str], place: int) -> float:
    text = row[place].strip() if place < len(row) else ""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        message = f"{path}, line {line}: {text!r} is not a number: correct it"
        raise SmartTouchError(message, about="line", problem="malformed", value=line)
    return value
