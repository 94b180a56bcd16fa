"""Tasks: each turns a condition into intervals, a question, and the correct answer."""

from dataclasses import dataclass, replace
from typing import Any

from smarttouch.experiments.psychophysics.procedures import Condition
from smarttouch.experiments.psychophysics.trials import (
    ENOUGH,
    FIRST_OR_SECOND,
    LEFT_OR_RIGHT,
    YES_OR_NO,
    Stimuli,
    Train,
    Trial,
)

_WHERE = {1: "first", 2: "second"}


def in_two_intervals(
    condition: Condition,
    own: Train,
    other: Train,
    task: str,
    question: str,
    words: str,
    unit: str,
    **more: Any,
) -> Trial:
    """Return a trial of two intervals: ``own`` is in that of the comparison, which is right.

    ``task`` is the kind of question for simulated observers, ``words`` the comparison in words, and
    ``unit`` its unit; ``more`` are other fields of a `Trial`.
    """
    at = condition.comparison_interval
    return Trial(
        condition, (own, other) if at == 1 else (other, own), task=task,
        question=f"{question} 1 or 2", answers=FIRST_OR_SECOND, success=str(at),
        words=f"{words} {_WHERE[at]}", unit=unit, **{"target": str(at)} | more,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class FrequencyTask:
    """Frequency discrimination: which of two trains is faster (paper, Section III.C)?"""

    stimuli: Stimuli
    site: int

    def trial(self, condition: Condition) -> Trial:
        """Return the trial: two trains of the same length."""
        standard, comparison = condition.standard, condition.comparison
        at = condition.comparison_interval
        own, other = (self.stimuli.train([self.site], each) for each in (comparison, standard))
        target = "" if comparison == standard else str(at if comparison > standard else 3 - at)
        words = f"standard {standard:g} Hz, comparison {comparison:g} Hz"
        return in_two_intervals(
            condition, own, other, "faster", "which was faster?", words, "Hz",
            target=target, compares=True,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class DetectionTask:
    """Detection: is anything felt; or, in two intervals, in which?

    A condition is the current of the strongest electrode of the site's kernel, mA; at 0 nothing
    flows.
    """

    stimuli: Stimuli
    site: int
    rate_hz: float

    def trial(self, condition: Condition) -> Trial:
        """Return the trial: a train, or a train and a blank."""
        current_ma, at = condition.comparison, condition.comparison_interval
        full_ma = float(self.stimuli.profile.full_ma[self.site])
        train = self.stimuli.train([self.site], self.rate_hz)
        blank = train.blank()
        if current_ma > 0:
            # A blank keeps the level, so that what follows need not rise first.
            train, blank = (
                replace(each, level=min(1.0, current_ma / full_ma)) for each in (train, blank)
            )
        else:
            train = blank
        if not at:
            target = "y" if current_ma > 0 else "n"
            words = f"{current_ma:.3f} mA" if current_ma > 0 else "blank"
            return Trial(
                condition, (train,), "felt", "did you feel it? y or n", YES_OR_NO, target, "y",
                words, "mA", exact=True,
            )  # fmt: skip
        return in_two_intervals(
            condition, train, blank, "felt", "in which did you feel it?", f"{current_ma:.3f} mA",
            "mA", exact=True,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class DiscomfortTask:
    """Upper limit: when is a rising current enough? It rises evenly to the strongest of the
    profile.

    The comparison of the condition is not a number, but the result.
    """

    stimuli: Stimuli
    site: int
    rate_hz: float

    def trial(self, condition: Condition) -> Trial:
        """Return the trial: a train that rises until it is enough."""
        train = replace(self.stimuli.train([self.site], self.rate_hz), rises=True)
        return Trial(
            condition, (train,), "enough", "press Enter when it is enough", ENOUGH, target="",
            success="y", words="current rises", unit="mA", exact=True,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class LocalizationTask:
    """Localization: was the second point left or right of the first, by an offset in mm?"""

    stimuli: Stimuli
    site: int
    rate_hz: float

    def trial(self, condition: Condition) -> Trial:
        """Return the trial: a point, and another one beside it."""
        right_mm = condition.comparison
        beside = self.stimuli.beside(self.site)
        other = beside[min(beside, key=lambda far_mm: abs(far_mm - right_mm))]
        trains = tuple(self.stimuli.train([each], self.rate_hz) for each in (self.site, other))
        side = "right" if right_mm > 0 else "left"
        return Trial(
            condition, trains, "side", "was the second left or right? arrow keys", LEFT_OR_RIGHT,
            target=side[0], success="r", words=f"second {abs(right_mm):g} mm {side}", unit="mm",
        )  # fmt: skip
