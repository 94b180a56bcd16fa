"""Calibration of skin contact and of a load cell, and the profile file for the results."""

import math
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping, MutableMapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import tomlkit
from numpy.typing import NDArray

from smarttouch.base import __version__
from smarttouch.base.errors import CalibrationError, LineLostError, ProfileError
from smarttouch.base.files import (
    MOST_TOML_BYTES,
    read_text,
    read_toml,
    require_replaceable,
    write_bytes,
)
from smarttouch.boards.board import Board
from smarttouch.boards.impedance import Condition, Impedance
from smarttouch.experiments.procedures import middle_and_spread
from smarttouch.profile import ForceLaw, Profile, load_profile
from smarttouch.profile.toml_files import difference, in_rows, profile_of, profile_path
from smarttouch.sources.force import open_cell

Value = str | float | Sequence[float]

_LIBRARIES = {"opencv": "opencv-contrib-python-headless", "numpy": "numpy", "scipy": "scipy"}


class ProfileFile:
    """Copy of a profile, to which a calibration adds results. `write` stores it as a TOML file.

    ``start`` names a shipped profile or a file. The copy keeps the comments, and the values that
    the calibration does not change. With ``overwrite``, `write` may replace an existing file. With
    ``update``, `write` replaces the file ``start``. Raises ProfileError if ``start`` is not a
    profile, and CalibrationError if the output cannot be written.
    """

    def __init__(
        self, start: str, output: Path, overwrite: bool = False, *, update: bool = False
    ) -> None:
        source = profile_path(start)
        self._text, self._document, profile = _begin(source)
        self.profile: Profile = profile
        self.output: Path = output
        self._update, self._overwrite = update, overwrite
        if output.suffix != ".toml":
            raise CalibrationError(
                f"the new profile {output} must end in .toml: give another --output"
            )
        if not output.absolute().parent.is_dir():
            raise CalibrationError(f"cannot write {output}: its folder does not exist: create it")
        self._require_free(output)
        if (named := self._table("optics").get("flat_field")) is not None:
            named_path = (source.parent / str(named)).resolve()
            self.set("optics.flat_field", os.path.relpath(named_path, output.absolute().parent))

    def beside(self, ending: str) -> Path:
        """Return the path of the output with another file extension."""
        return self.output.with_name(f"{self.output.stem}.{ending}")

    def set(self, key: str, value: Value) -> None:
        """Set a key of the profile, such as ``force.curve``."""
        table, _, name = key.partition(".")
        self._table(table)[name] = value if isinstance(value, str | int | float) else in_rows(value)

    def note(self, what: str, found: str) -> None:
        """Record the result of a calibration in the profile, with time and software versions."""
        used = [("smarttouch", __version__)]
        used += [(name, version(package)) for name, package in _LIBRARIES.items()]
        entry = tomlkit.table()
        entry["when"] = datetime.now(UTC).replace(microsecond=0)
        entry["versions"] = ", ".join(f"{name} {number}" for name, number in used)
        entry["found"] = found
        if "calibrated" not in self._document:
            self._document["calibrated"] = tomlkit.table(is_super_table=True)
        self._table("calibrated")[what] = entry

    def write(self, others: Mapping[Path, bytes] | None = None) -> Profile:
        """Write the profile and the files ``others``. Return the profile as loaded from disk."""
        for path in (self.output, *(others or {})):
            self._require_free(path)
        text = tomlkit.dumps(self._document)
        try:
            profile_of(tomllib.loads(text), self.output)
        except ProfileError as error:
            message = str(error).removeprefix(f"{self.output}: ")
            raise CalibrationError(
                f"the results do not make a valid profile, so nothing was written: {message}",
                electrode=error.electrode,
            ) from None
        # Write the profile last: the files that it names must exist.
        for path, data in {**(others or {}), self.output: text.encode()}.items():
            write_bytes(path, data, CalibrationError)
        return load_profile(self.output)

    def _require_free(self, path: Path) -> None:
        require_replaceable(path, CalibrationError)
        if self._update and path == self.output:
            if read_text(path, CalibrationError, MOST_TOML_BYTES) != self._text:
                raise CalibrationError(
                    f"another program changed {path} during the calibration, so nothing was "
                    "written: repeat the command"
                )
        elif path.exists() and not self._overwrite:
            raise CalibrationError(f"{path} already exists: give another file, or add --overwrite")

    def _table(self, name: str) -> MutableMapping[str, Any]:
        table = self._document[name]
        # For a table in several parts of the file, tomlkit returns a proxy, which is not a Table.
        assert isinstance(table, MutableMapping)
        return table


def file_to_calibrate(
    part: str,  # name of the calibration
    # initial profile; an existing output must equal it, except for name, title, command defaults
    # and results of calibrations
    start: str | None,
    fallback: str,  # initial profile if `start` is None
    output: Path,
    overwrite: bool = False,  # whether to replace an earlier calibration of this name
    *,
    # whether the results are simulated; such results replace measured ones only with `overwrite`
    simulated: bool = False,
) -> ProfileFile:
    """Return the profile file to which a calibration adds its results.

    An existing output is updated. The results of other calibrations in the file are kept.
    """
    if not output.exists():
        return ProfileFile(start or fallback, output, overwrite)
    require_replaceable(output, CalibrationError)
    file = ProfileFile(str(output), output, overwrite, update=True)
    key = None if start is None else difference(file.profile, _begin(profile_path(start))[-1])
    if key is not None:
        raise CalibrationError(
            f"{output} exists and differs from {start} in {key}: leave out --profile to continue "
            f"with {output}, or give another file to --output"
        )
    if part in file.profile.calibrated and not overwrite:
        raise CalibrationError(
            f"{output} already contains a calibration of {part}: add --overwrite to replace it, "
            "or give another file to --output"
        )
    notes = file.profile.calibrated
    measured = [name for name in notes if not notes[name].found.startswith("simulated")]
    if simulated and measured and not overwrite:
        raise CalibrationError(
            f"{output} contains a calibration of {measured[0]} with a real finger or sensor, but "
            "this calibration is simulated: write it to another --output, or add --overwrite"
        )
    return file


def _begin(path: Path) -> tuple[str, tomlkit.TOMLDocument, Profile]:
    """Read a profile file. Return its text, its TOML document (for editing) and its profile."""
    table, text = read_toml(path, ProfileError), read_text(path, ProfileError, MOST_TOML_BYTES)
    try:
        document = tomlkit.parse(text)
    except (tomlkit.exceptions.TOMLKitError, ValueError, RecursionError) as error:
        raise ProfileError(f"cannot edit {path} ({error}): correct the file", key="file") from None
    return text, document, profile_of(table, path)


MOST_BROKEN = 0.5
"""Largest allowed share of open or shorted electrodes; above it the finger is off the array."""
MOST_RESTLESS = 0.5
"""Largest allowed relative spread of repeated impedances (median over the electrodes). A larger
spread means that the finger moved."""
MOST_LOSSES = 3  # largest number of times that a measurement reopens a lost board


@dataclass(frozen=True, eq=False)
class ContactFound:
    """Contact of each electrode with the skin."""

    kohm: NDArray[np.float64]  # (E,): median impedance; infinite if open
    # (E,): robust standard deviation; NaN after one measurement, or if an impedance was infinite
    spread_kohm: NDArray[np.float64]
    # (E,): condition in the majority of measurements; ``unsure`` without a majority
    condition: tuple[Condition, ...]
    repeats: int
    current_ma: float

    @property
    def broken(self) -> list[int]:
        """Electrodes that are open or shorted."""
        return [i for i, condition in enumerate(self.condition) if condition in ("open", "short")]

    def masked(self, profile: Profile) -> list[int]:
        """Return the electrodes to mask: broken ones and those that the profile masks."""
        return sorted({*profile.output.masked, *self.broken})

    def impedances(self, profile: Profile) -> list[float]:
        """Return an impedance for each electrode, kΩ. Broken electrodes get the others' median."""
        touching = np.isfinite(self.kohm) & ~np.isin(np.arange(len(self.kohm)), self.broken)
        typical_kohm = float(np.median(self.kohm[touching]))
        return [float(f"{kohm:.4g}") for kohm in np.where(touching, self.kohm, typical_kohm)]

    def sentence(self) -> str:
        """Return the sentence that the profile stores about this result."""
        good = np.array([condition == "good" for condition in self.condition])
        low, middle, high = np.percentile(self.kohm[good], [0, 50, 100])
        counts = [f"{good.sum()} good"]
        for condition in ("open", "short", "unsure"):
            if at := [str(i) for i, has in enumerate(self.condition) if has == condition]:
                counts.append(f"{len(at)} {condition} (electrodes {', '.join(at)})")
        spread = np.nanmedian(self.spread_kohm[good]) / middle if self.repeats > 1 else np.nan
        return (
            f"{', '.join(counts)} of {len(self.kohm)} electrodes; good electrodes: median "
            f"impedance {middle:.3g} kohm ({low:.3g} to {high:.3g}); {self.repeats} measurements "
            f"of each electrode at {self.current_ma:.2g} mA"
            + ("" if np.isnan(spread) else f", which differ by {spread:.1%}")
        )


def measure_contact(
    opened: Callable[[], AbstractContextManager[Board]], repeats: int
) -> list[Impedance]:
    """Measure impedances repeatedly. Reopen a lost board, at most `MOST_LOSSES` times."""
    impedances: list[Impedance] = []
    losses = 0
    while True:
        try:
            with opened() as board:
                while len(impedances) < repeats:
                    impedances.append(board.measure())
                return impedances
        except LineLostError:
            losses += 1
            if losses > MOST_LOSSES:
                raise


def judge_contact(measured: Sequence[Impedance]) -> ContactFound:
    """Combine repeated measurements; reject them if the finger moved or did not touch."""
    if any(impedance.lifted for impedance in measured):
        raise CalibrationError(
            "no electrode touches anything: put the finger on the array, and measure again"
        )
    kohm = np.array([impedance.kohm for impedance in measured])
    condition = tuple(
        _majority(impedance) for impedance in zip(*(m.condition for m in measured), strict=True)
    )
    count = len(condition)
    # Infinite readings (open electrodes) sort last and count as large values in the median.
    middle = np.sort(kohm, axis=0)[(len(kohm) - 1) // 2 : len(kohm) // 2 + 1].mean(axis=0)
    touching = np.isfinite(kohm).all(axis=0)
    spread = np.full(count, np.nan)
    if len(kohm) > 1:
        away = np.abs(kohm[:, touching] - middle[touching])
        spread[touching] = 1.4826 * np.median(away, axis=0)
    contact = ContactFound(middle, spread, condition, len(measured), measured[0].current_ma)
    broken, good = len(contact.broken), condition.count("good")
    lost = broken > MOST_BROKEN * count
    if lost or not good:
        raise CalibrationError(
            f"{broken} of {count} electrodes do not touch or are shorted, and {good} are good: "
            "clean and moisten the finger, lay it on the whole array, and measure again"
        )
    restless = np.nanmedian(spread[touching] / middle[touching]) if len(kohm) > 1 else 0.0
    if restless > MOST_RESTLESS:
        raise CalibrationError(
            f"repeated measurements of an electrode differ by {restless:.0%}: hold the finger "
            "still, and measure again"
        )
    return contact


def _majority(conditions: Sequence[Condition]) -> Condition:
    """Return the condition in the majority of measurements, or ``unsure`` without a majority."""
    for condition in conditions:
        if 2 * conditions.count(condition) > len(conditions):
            return condition
    return "unsure"


STANDARD_GRAVITY = 9.80665  # m/s²
FEWEST_READINGS = 5
MOST_MISSING = 0.5  # largest allowed share of readings that are not numbers
MOST_RESIDUAL = 0.05  # largest allowed rms error of the fitted line, relative to full force
MOST_DRIFT = 0.03  # largest allowed drift of the reading under one weight, relative to full force
LEAST_REACH = 0.5  # the heaviest weight must reach at least this share of full force


class Cell(Protocol):
    """Source of raw readings, such as a load cell on a serial port."""

    def collect(self, seconds: float) -> NDArray[np.float64]: ...


@dataclass(frozen=True)
class Weighing:
    """Readings of the load cell under one weight."""

    grams: float
    reading: float  # median of the raw readings
    spread: float  # robust standard deviation of the readings
    drift: float  # change from the first half of the readings to the second
    count: int  # number of readings

    @property
    def force_n(self) -> float:
        return self.grams / 1000 * STANDARD_GRAVITY


@dataclass(frozen=True)
class ForceFound:
    """Line fitted to weighings. It converts readings of a load cell to forces."""

    curve: tuple[float, float]  # intercept, N, and slope, N per count
    full_n: float  # full force, to which percentages refer
    weighings: tuple[Weighing, ...]

    def force_n(self, reading: float) -> float:
        return self.curve[0] + self.curve[1] * reading

    @property
    def off_n(self) -> NDArray[np.float64]:
        """Error of the fitted line at each weighing, N."""
        return np.array(
            [self.force_n(weighing.reading) - weighing.force_n for weighing in self.weighings]
        )

    @property
    def residual_n(self) -> float:
        """Root mean square error of the fitted line, N."""
        return float(np.sqrt(np.mean(self.off_n**2)))

    def sentence(self) -> str:
        """Return the sentence that the profile stores about this result."""
        grams = [weighing.grams for weighing in self.weighings]
        zero_n, slope_n = self.curve
        return (
            f"line through {len(grams)} weighings from {min(grams):g} to {max(grams):g} g: zero "
            f"force at {-zero_n / slope_n:.6g} counts, slope {slope_n:.4g} N per count, rms error "
            f"{self.residual_n:.4f} N ({self.residual_n / self.full_n:.2%} of full force), largest "
            f"error {np.abs(self.off_n).max():.4f} N"
        )


def weigh_on(url: str, weights: Iterable[float], seconds: float) -> list[Weighing]:
    """Weigh with the load cell at a URL; ``weights`` yields each weight, g, when it is in place."""
    with open_cell(url) as cell:
        return [weigh(cell, grams, seconds) for grams in weights]


def parse_grams(text: str) -> float:
    """Parse a weight in grams that a user typed."""
    try:
        grams = float(text)
    except ValueError:
        grams = math.nan
    if not 0 <= grams < math.inf:
        raise CalibrationError(f"{text!r} is not a weight: give grams, such as 20")
    return grams


def weigh(cell: Cell, grams: float, seconds: float) -> Weighing:
    """Collect readings of the load cell under one weight."""
    raw = np.asarray(cell.collect(seconds), np.float64)
    good = raw[np.isfinite(raw)]
    if len(good) < FEWEST_READINGS or len(good) < (1 - MOST_MISSING) * len(raw):
        raise CalibrationError(
            f"only {len(good)} of {len(raw)} readings at {grams:g} g are numbers (needed: at least "
            f"{FEWEST_READINGS}, and at least half of the readings): check the connections of the "
            "cell, or read longer (--seconds)"
        )
    middle, spread = middle_and_spread(good)
    half = len(good) // 2
    drift = float(np.median(good[half:]) - np.median(good[:half]))
    return Weighing(grams, middle, spread, drift, len(good))


def fit_curve(weighings: Sequence[Weighing], law: ForceLaw) -> ForceFound:
    """Fit a line to weighings of at least three weights. Raises CalibrationError if the rms error
    of the line or a drift is too large relative to full force."""
    grams = np.array([weighing.grams for weighing in weighings])
    reading = np.array([weighing.reading for weighing in weighings])
    _require_weights(grams, law)
    _require_answer(weighings, reading)
    # Polynomial.fit scales the readings: raw counts are too large for an accurate fit.
    forces = [weighing.force_n for weighing in weighings]
    zero_n, slope_n = np.polynomial.Polynomial.fit(reading, forces, 1).convert().coef
    curve = float(f"{zero_n:.9g}"), float(f"{slope_n:.9g}")
    force_fit = ForceFound(curve, law.full_n, tuple(weighings))
    if force_fit.residual_n > MOST_RESIDUAL * law.full_n:
        worst = weighings[int(np.abs(force_fit.off_n).argmax())]
        raise CalibrationError(
            f"the line fitted to the weights is off by {force_fit.residual_n:.3f} N rms, more than "
            f"{MOST_RESIDUAL:.0%} of full force ({law.full_n:g} N): weigh {worst.grams:g} g again"
        )
    restless = max(weighings, key=lambda weighing: abs(weighing.drift))
    drift_n = abs(restless.drift * force_fit.curve[1])
    if drift_n > MOST_DRIFT * law.full_n:
        raise CalibrationError(
            f"the reading drifted by {drift_n:.3f} N while {restless.grams:g} g lay on the cell: "
            "wait until the reading settles, and weigh again"
        )
    return force_fit


def _require_weights(grams: NDArray[np.float64], law: ForceLaw) -> None:
    distinct = len(np.unique(grams))
    if distinct < 3:
        raise CalibrationError(
            f"{distinct} different weights cannot show that the cell is linear: give three or more"
        )
    full_g = 1000 * law.full_n / STANDARD_GRAVITY
    if grams.max() < LEAST_REACH * full_g:
        raise CalibrationError(
            f"the heaviest weight, {grams.max():g} g, is far below full force, {full_g:.0f} g: "
            f"add a weight of about {full_g:.0f} g"
        )


def _require_answer(weighings: Sequence[Weighing], reading: NDArray[np.float64]) -> None:
    noise = float(np.median([weighing.spread for weighing in weighings]))
    moved = float(np.ptp(reading))
    if moved <= 5 * noise or moved == 0:
        raise CalibrationError(
            f"the readings of all weights differ by {moved:.6g}, not much more than their noise "
            f"of {noise:.6g}: check that the cell is connected and the weights lie on it"
        )
