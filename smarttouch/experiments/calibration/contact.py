"""Contact of each electrode with the skin, from repeated measurements; tables of calibrations."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from smarttouch.base import terminal
from smarttouch.base.errors import CalibrationError, LineLostError
from smarttouch.base.terminal import print_table
from smarttouch.boards.board import Board
from smarttouch.boards.reports import Condition, Impedance
from smarttouch.profile import Profile

if TYPE_CHECKING:
    from smarttouch.experiments.calibration.force_curve import ForceFound
    from smarttouch.experiments.calibration.page_registration import RegistrationFound
    from smarttouch.experiments.calibration.sensor_optics import OpticsFound
    from smarttouch.profile.electrodes import ElectrodeArray

MOST_BROKEN = 0.5
"""Largest part of open or shorted electrodes; with more, the finger lies beside the array."""
MOST_RESTLESS = 0.5
"""Largest spread of the median electrode over its median; with more, the finger moved."""
MOST_LOSSES = 3  # times that a board may be lost while it measures


@dataclass(frozen=True, eq=False)
class ContactFound:
    """Contact of each electrode."""

    kohm: NDArray[np.float64]  # (E,): medians; infinite where open
    # (E,): robust standard deviations; NaN of one measurement, or where open
    spread_kohm: NDArray[np.float64]
    # (E,): result of most measurements; ``unsure`` where they disagree
    condition: tuple[Condition, ...]
    repeats: int
    current_ma: float

    @property
    def broken(self) -> list[int]:
        """Electrodes that are open or shorted."""
        return [i for i, each in enumerate(self.condition) if each in ("open", "short")]

    def masked(self, profile: Profile) -> list[int]:
        """Return the electrodes to mask: broken ones, and those that were masked before."""
        return sorted({*profile.output.masked, *self.broken})

    def impedances(self, profile: Profile) -> list[float]:
        """Return an impedance for each electrode, kΩ: the median where none was measured."""
        touching = np.isfinite(self.kohm) & ~np.isin(np.arange(len(self.kohm)), self.broken)
        usual = float(np.median(self.kohm[touching]))
        return [float(f"{each:.4g}") for each in np.where(touching, self.kohm, usual)]

    def sentence(self) -> str:
        """Return the sentence for the profile."""
        good = np.array([each == "good" for each in self.condition])
        low, middle, high = np.percentile(self.kohm[good], [0, 50, 100])
        counts = [
            f"{self.condition.count(each)} {each}"
            for each in ("good", "open", "short", "unsure")
            if each in self.condition
        ]
        spread = np.nanmedian(self.spread_kohm[good]) / middle if self.repeats > 1 else np.nan
        return (
            f"{', '.join(counts)} of {len(self.kohm)} electrodes, the good ones {middle:.3g} kohm "
            f"({low:.3g} to {high:.3g}), {self.repeats} measurements at {self.current_ma:.2g} mA"
            + ("" if np.isnan(spread) else f" that differ by {spread:.1%}")
        )


def measure_contact(
    opened: Callable[[], AbstractContextManager[Board]], repeats: int
) -> list[Impedance]:
    """Measure repeatedly; a board that is lost meanwhile is opened again, up to `MOST_LOSSES`
    times."""
    found: list[Impedance] = []
    losses = 0
    while True:
        try:
            with opened() as board:
                while len(found) < repeats:
                    found.append(board.measure())
                return found
        except LineLostError:
            losses += 1
            if losses > MOST_LOSSES:
                raise


def judge_contact(measured: Sequence[Impedance]) -> ContactFound:
    """Return the joint result of repeated measurements."""
    if any(each.lifted for each in measured):
        raise CalibrationError(
            "no electrode touches anything: put the finger on the array, and measure again"
        )
    kohm = np.array([each.kohm for each in measured])
    condition = tuple(_most(each) for each in zip(*(m.condition for m in measured), strict=True))
    count = len(condition)
    # A reading without end is as far from the others as one can be: the median still holds.
    middle = np.sort(kohm, axis=0)[(len(kohm) - 1) // 2 : len(kohm) // 2 + 1].mean(axis=0)
    touching = np.isfinite(kohm).all(axis=0)
    spread = np.full(count, np.nan)
    if len(kohm) > 1:
        away = np.abs(kohm[:, touching] - middle[touching])
        spread[touching] = 1.4826 * np.median(away, axis=0)
    found = ContactFound(middle, spread, condition, len(measured), measured[0].current_ma)
    broken, good = len(found.broken), condition.count("good")
    lost = broken > MOST_BROKEN * count
    if lost or not good:
        raise CalibrationError(
            f"{broken} of {count} electrodes do not touch or are shorted, and {good} are good: lay "
            "the finger on all of the array, clean and moisten it, and measure again"
        )
    restless = np.nanmedian(spread[touching] / middle[touching]) if len(kohm) > 1 else 0.0
    if restless > MOST_RESTLESS:
        raise CalibrationError(
            f"measurements of one electrode differ by {restless:.0%}: hold the finger still, and "
            "measure again"
        )
    return found


def _most(conditions: Sequence[Condition]) -> Condition:
    """Return the result of more than half of the measurements."""
    for each in conditions:
        if 2 * conditions.count(each) > len(conditions):
            return each
    return "unsure"


_MARKS = {"open": "open", "short": "short", "unsure": "?"}
_NEAR = 0.25  # part of a pitch: electrodes whose heights differ by less stand in one row


def show_optics(found: "OpticsFound") -> None:
    """Show unevenness, noise and broken pixels."""
    rows = (
        ("blank paper uneven", f"{found.uneven_before:.1%}", f"{found.uneven_after:.1%}"),
        ("dead, hot pixels", f"{found.dead}, {found.hot}", "as the nearest good one"),
        ("dark level", f"{found.dark_level:.1f}", "0"),
        ("noise", f"{found.noise_levels:.2f}", ""),
    )
    print_table(rows, ("", "before", "after"), left=3)


def show_registration(found: "RegistrationFound") -> None:
    """Show the places of electrodes, and how well the image agrees with the target."""
    outside = set(found.outside.tolist())
    rows = [
        (str(index), f"{column:.2f}", f"{row:.2f}", "beyond the image" * (index in outside))
        for index, (column, row) in enumerate(found.electrode_pixel)
    ]
    print_table(rows, ("electrode", "column", "row", ""), left=4)
    fit = (str(found.markers), f"{found.correlation:.3f}", f"{found.tilt_deg:.1f}")
    print_table([fit], ("markers", "correlation", "tilt, degrees"), left=3)


def show_force(found: "ForceFound") -> None:
    """Show each weighing, and its force by the curve."""
    rows = []
    for each in found.weighings:
        seen_n = found.force_n(each.reading)
        measured = (f"{each.grams:g}", f"{each.force_n:.4f}", f"{each.reading:.6g}")
        off = f"{seen_n - each.force_n:+.4f}"
        rows.append((*measured, f"{each.spread:.3g}", f"{seen_n:.4f}", off))
    print_table(rows, ("g", "N", "reading", "spread", "by the curve, N", "off, N"), left=6)


def show_contact(found: "ContactFound", electrodes: "ElectrodeArray") -> None:
    """Show the array as it lies under the finger, an impedance at each electrode's place."""
    console = terminal.console()
    width = max(60, console.width)
    rows = _rows(electrodes)
    left = float(electrodes.position_mm[:, 0].min())
    span = float(np.ptp(electrodes.position_mm[:, 0])) or 1.0
    cell = 7
    for row in rows:
        line = [" "] * (width + cell)
        for index in row:
            condition = found.condition[index]
            text = _MARKS.get(condition) or f"{found.kohm[index]:.1f}"
            part = (float(electrodes.position_mm[index, 0]) - left) / span
            at = round(part * min(width - cell, cell * (_widest(rows) - 1)))
            line[at : at + cell] = f"{text:>{cell - 1}} "
        console.print("".join(line).rstrip(), highlight=False, soft_wrap=True)
    console.print("kohm of each electrode where it lies; open, short, ?: not good", style="dim")


def _rows(electrodes: "ElectrodeArray") -> list[list[int]]:
    """Return the electrodes row by row from the top, each row from the left."""
    position = electrodes.position_mm
    rows: list[list[int]] = []
    for index in np.lexsort((position[:, 0], position[:, 1])).tolist():
        above = rows[-1][0] if rows else None
        if above is not None and (
            position[index, 1] - position[above, 1] < _NEAR * electrodes.pitch_mm
        ):
            rows[-1].append(index)
        else:
            rows.append([index])
    return [sorted(row, key=lambda each: float(position[each, 0])) for row in rows]


def _widest(rows: Sequence[Sequence[int]]) -> int:
    # Rows of a hexagon stand between each other: twice as many places as electrodes in a row.
    return max(2, max(len(row) for row in rows))
