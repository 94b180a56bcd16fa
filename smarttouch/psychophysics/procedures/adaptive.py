"""Adaptive procedures with the ranges that suit each experiment."""

from collections.abc import Sequence

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.fitting.psychometric import Model
from smarttouch.psychophysics.procedures.constant import WIDEST_RATIO
from smarttouch.psychophysics.procedures.procedure import Interleaved, Procedure
from smarttouch.psychophysics.procedures.quest import QuestPlus
from smarttouch.psychophysics.procedures.staircase import WeightedStaircase

NARROWEST_RATIO = 1.01
_START_RATIO = 1.6
"""First ratio of a staircase: clearly faster (our own choice)."""
_STEP = 0.03
"""Step of a staircase of frequencies: a quarter of the mechanical threshold of about 20 % is 5 %.
"""
_DETECTION_STEP = 0.05
_DETECTION_RANGE = (0.3, 3.0)
"""Range of detection, as parts of the profile's threshold."""


def frequency_procedures(
    method: str, standards: Sequence[float], highest_hz: float, trials: int | None, seed: int
) -> Procedure:
    """Return a staircase or QUEST+ of each standard, mixed at random.

    Comparisons are faster than the standard: the upper threshold is looked for.
    """
    procedures: list[Procedure] = []
    for index, standard in enumerate(standards):
        low, high = NARROWEST_RATIO * standard, min(WIDEST_RATIO * standard, highest_hz)
        if high <= low:
            raise ExperimentError(
                f"nothing can be faster than a standard of {standard:g} Hz within the profile's "
                f"limit of {highest_hz:g} Hz: give lower standards",
                about="standards",
            )
        order = seed + 1000 * index
        if method == "staircase":
            first, most = min(_START_RATIO * standard, high), trials or 80
            procedures.append(
                WeightedStaircase(first, low, high, _STEP, standard, most_trials=most, seed=order)
            )
        else:
            most = trials or 60
            procedures.append(
                QuestPlus(
                    low,
                    high,
                    Model(guess=0.5),
                    standard,
                    most,
                    fewest_trials=min(20, most),
                    seed=order,
                )
            )
    return Interleaved(procedures, seed)


def detection_procedure(
    method: str,
    threshold_ma: float,
    full_ma: float,
    two_intervals: bool,
    trials: int | None,
    seed: int,
) -> Procedure:
    """Return a staircase or QUEST+ of current, up to the strongest comfortable one."""
    low, high = _DETECTION_RANGE[0] * threshold_ma, min(_DETECTION_RANGE[1] * threshold_ma, full_ma)
    if method == "staircase":
        start = min(1.5 * threshold_ma, high)
        return WeightedStaircase(
            start, low, high, _DETECTION_STEP, most_trials=trials or 80,
            two_intervals=two_intervals, seed=seed,
        )  # fmt: skip
    model = Model(guess=0.5 if two_intervals else 0.0)
    return QuestPlus(
        low, high, model, 0.0, trials or 60, fewest_trials=min(20, trials or 60),
        two_intervals=two_intervals, seed=seed,
    )  # fmt: skip
