"""Polarity test: cathodic over anodic threshold of lone discs, which says what anatomy is like."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smarttouch.experiments.fitting.psychometric import Estimate, Model
from smarttouch.experiments.psychophysics.adaptive_procedures import QuestPlus, detection_range
from smarttouch.experiments.psychophysics.procedures import Interleaved
from smarttouch.profile import Profile

POLARITY_TRIALS = 12  # answers to each polarity of a lone disc
_STEEP = 0.3  # largest spread of *felt* from disc to disc, in spans of the stimuli (our own choice)


def polarity_range(profile: Profile, sites: Sequence[int]) -> tuple[float, float]:
    """Return the smallest and largest current of a polarity test, mA."""
    return detection_range(
        float(np.median(profile.threshold_ma[sites])), float(profile.full_ma[sites].min())
    )


def polarity_procedure(
    profile: Profile, sites: Sequence[int], trials: int | None, seed: int
) -> Interleaved:
    """Return QUEST+ of the current at which discs are felt: anodic, and cathodic, mixed."""
    most = trials or POLARITY_TRIALS
    low, high = polarity_range(profile, sites)
    model = Model(guess="equal", at=0.5)
    one, other = (
        QuestPlus(
            low, high, model, most_trials=most, fewest_trials=most, two_intervals=False,
            widest=_STEEP,
        )
        for _ in range(2)
    )  # fmt: skip
    return Interleaved((one, other), seed)


@dataclass(frozen=True)
class PolarityRatio:
    """Cathodic over anodic threshold of a disc, and how sure it is."""

    anodic: Estimate
    cathodic: Estimate

    @property
    def ratio(self) -> float:
        return self.cathodic.threshold / self.anodic.threshold

    @property
    def log_spread(self) -> float:
        """Standard deviation of its natural logarithm."""
        parts = (each.spread / each.threshold for each in (self.anodic, self.cathodic))
        return math.hypot(*parts)

    @property
    def interval(self) -> tuple[float, float]:
        """Its 95 % credible interval."""
        far = math.exp(1.96 * self.log_spread)
        return self.ratio / far, self.ratio * far

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"cathodic over anodic threshold {self.ratio:.2f} (95 % {low:.2f} to {high:.2f}): "
            f"{self.cathodic.threshold:.2f} over {self.anodic.threshold:.2f} mA"
        )


def polarity_ratio(procedure: Interleaved) -> PolarityRatio | None:
    """Return the ratio by the answers to `polarity_procedure` until now; None without any."""
    anodic, cathodic = procedure.estimates()
    return None if anodic is None or cathodic is None else PolarityRatio(anodic, cathodic)
