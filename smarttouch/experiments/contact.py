"""Contact of each electrode with the skin, from repeated measurements."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import CalibrationError, LineLostError
from smarttouch.boards.board import Board
from smarttouch.boards.reports import Condition, Impedance
from smarttouch.profile import Profile

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
        counts = [f"{good.sum()} good"]
        for each in ("open", "short", "unsure"):
            if at := [str(i) for i, has in enumerate(self.condition) if has == each]:
                counts.append(f"{len(at)} {each} (electrodes {', '.join(at)})")
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
