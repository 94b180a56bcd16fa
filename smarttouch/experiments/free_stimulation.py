"""Free stimulation: the subject sets amplitude, rate, class and site by keys (paper, III-A)."""

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError, require_within
from smarttouch.base.events import Marked, Note
from smarttouch.experiments.thresholds import measuring_profile
from smarttouch.profile import Profile
from smarttouch.profile.profile import require_driven
from smarttouch.running.step_records import Listener, StepResult
from smarttouch.sources.source_contract import Stimulus, StimulusSource

SLOWEST_HZ = 10.0  # lowest pulse rate (paper, III-B.1)
STEP_HZ = 5.0  # change of the pulse rate per key press


def raise_to_device_limits(profile: Profile) -> Profile:
    """Return a copy of a profile with comfort levels at the device's limits (in the paper 2 mA)."""
    return measuring_profile(profile, spare_ma=len(profile.electrodes) / 2000)


class FreeSource(StimulusSource, Listener):
    """Endless pulse train at one site. Keys change its rate, class and site; after a change of
    class or site the intensity rises from zero."""

    keys_help = "← → rate    [ ] site    1 to 9 mark    "
    knows_force = True
    frames: int

    def __init__(
        self, profile: Profile, classes: list[Afferent], site: int, rate_hz: float, force_n: float
    ) -> None:
        super().__init__("free stimulation")
        require_within(ExperimentError, "rate_hz", rate_hz, SLOWEST_HZ, profile.limits.rate_hz)
        require_driven(profile, [site], ExperimentError, "site")
        self._profile, self._rate_hz, self._force_n = profile, rate_hz, force_n
        self._classes, self._sites = deque(classes), deque(profile.driven.tolist())
        self._sites.rotate(-self._sites.index(site))
        self._asked: deque[Callable[[], None]] = deque()
        self._level, self._from_zero = 0.0, False

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        actions = {
            "left": partial(self._turn_rate, -STEP_HZ), "right": partial(self._turn_rate, STEP_HZ),
            "[": partial(self._turn, self._sites, 1), "]": partial(self._turn, self._sites, -1),
            "m": partial(self._turn, self._classes, -1),
        }  # fmt: skip
        actions |= {mark: partial(self._mark, mark) for mark in "123456789"}
        return {key: partial(self._asked.append, action) for key, action in actions.items()}

    def read(self, time_ns: int) -> Stimulus:
        self._now_ns = time_ns
        while self._asked:
            self._asked.popleft()()
            self._note()
        level, self._from_zero = float(not self._from_zero), False
        activation = np.zeros((len(Afferent), len(self._profile.electrodes)), np.float32)
        activation[self._classes[0], self._sites[0]] = 1
        self.frames += 1
        period_us = round(1e6 / self._rate_hz)
        return Stimulus(activation, time_ns, self._force_n, period_us, level, number=self.frames)

    def step(self, result: StepResult) -> None:
        if result.step.level != self._level:
            self._level = result.step.level
            self._note()

    def _note(self) -> None:
        amplitude_ma = self._level * float(self._profile.full_ma[self._sites[0]])
        where = f"{self._classes[0].name}, site {self._sites[0]}, {self._rate_hz:g} Hz"
        self.emit(Note(self._now_ns, f"{where}, {amplitude_ma:.3f} mA"))

    def _mark(self, mark: str) -> None:
        self.emit(Marked(self._now_ns, mark))

    def _turn_rate(self, by_hz: float) -> None:
        self._rate_hz = min(self._profile.limits.rate_hz, max(SLOWEST_HZ, self._rate_hz + by_hz))

    def _turn(self, choices: deque[Afferent] | deque[int], by: int) -> None:
        choices.rotate(by)
        self._from_zero = True
