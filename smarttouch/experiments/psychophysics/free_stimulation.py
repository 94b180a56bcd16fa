"""Free stimulation: the subject sets amplitude, rate, mode and site.

The experiment system of the paper (Section III-A, Fig. 11 and 12), on which its qualitative
observations were made (Section III-B).
"""

import csv
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError, require_within
from smarttouch.base.events import Note
from smarttouch.base.files import owner_only, unwritable
from smarttouch.base.stopping import Closing
from smarttouch.experiments.psychophysics.trials import Stimuli
from smarttouch.profile import Profile
from smarttouch.profile.profile import require_driven
from smarttouch.running.listener import Listener
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Stimulus, StimulusSource

SLOWEST_HZ, FASTEST_HZ = 10.0, 200.0  # range of the pulse rate (paper, Section III-B.1)
_STEP_HZ = 5.0
COLUMNS = (
    "time_s", "what", "value", "amplitude_ma", "current_ma", "rate_hz", "mode", "site", "force_n",
)  # fmt: skip


def up_to_the_ceiling(profile: Profile) -> Profile:
    """Return a profile whose strongest current is the limit of the device, not of the finger.

    The subject's hand is on the amplitude, from zero (paper: 0 to 2.0 mA, Section III-A).
    """
    limits, count = profile.limits, len(profile.electrodes)
    # Sequences hold whole µA: charge and total have room for what rounding leaves over.
    rounding_ma = count / 2000
    by_charge_ma = 1000 * limits.charge_uc / profile.pulse.width_us - rounding_ma
    by_total_ma = profile.total_ma - rounding_ma
    most_ma = min(limits.current_ma, by_total_ma, by_charge_ma)
    ceiling_ma = [float(min(most_ma, each)) for each in limits.electrode_ma or [most_ma] * count]
    if (profile.threshold_ma >= ceiling_ma).any():
        raise ExperimentError(
            f"a threshold of {profile.threshold_ma.max():.2f} mA is not below the limit of "
            f"{most_ma:g} mA: correct perception.threshold_ma or limits.current_ma"
        )
    perception = profile.perception.model_dump() | {"comfort_ma": ceiling_ma}
    return Profile.model_validate({**profile.model_dump(), "perception": perception})


class FreeLog(Closing):
    """Log of every change, on disk at once, in a CSV file that must not exist yet."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = open(  # noqa: SIM115, until closing
                path, "x", newline="", encoding="utf-8-sig", opener=owner_only
            )
        except FileExistsError:
            raise ExperimentError(f"{path} exists: give another file") from None
        except OSError as error:
            raise unwritable(ExperimentError, path, error) from None
        self._writer = csv.writer(self._file)
        self.write(COLUMNS)

    def write(self, row: tuple[object, ...]) -> None:
        """Add a row."""
        try:
            self._writer.writerow(row)
            self._file.flush()
        except OSError as error:
            raise unwritable(ExperimentError, self.path, error) from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class FreeSource(StimulusSource, Listener):
    """Source of one endless train that the user adjusts; another class or site begins at zero
    intensity."""

    def __init__(
        self,
        profile: Profile,  # as `up_to_the_ceiling` returns it
        offered: tuple[Afferent, ...],  # the classes that its kernels reach
        log: FreeLog,  # receives every change
        afferent: Afferent = Afferent.RA,
        site: int | None = None,  # to begin with; the middle if None
        rate_hz: float = 50.0,
        # force of a virtual finger; boards that a finger may be on need another source
        press_n: float | None = None,
    ) -> None:
        super().__init__("free stimulation")
        fastest_hz = min(FASTEST_HZ, profile.limits.rate_hz)
        require_within(ExperimentError, "rate_hz", rate_hz, SLOWEST_HZ, fastest_hz)
        if afferent not in offered:
            raise ExperimentError(
                f"mode {afferent.name} is not possible with {profile.name}: choose "
                + " or ".join(each.name for each in offered)
            )
        if site is not None:
            require_driven(profile, [site], ExperimentError, "site")
        self.knows_force: bool = press_n is not None
        self.afferent: Afferent = afferent
        self.rate_hz: float = rate_hz
        self._profile, self._offered, self._log = profile, offered, log
        self._sites = profile.driven.tolist()
        self.site: int = Stimuli(profile, afferent, 1.0).middle if site is None else site
        self._press_n = float("nan") if press_n is None else press_n
        self._fastest_hz = fastest_hz
        self._full_ma = profile.full_ma
        self._asked: deque[Callable[[], None]] = deque()
        self._now_ns = 0
        self._force_n = 0.0
        self._level: float | None = None
        self._current_ma = 0.0
        self._from_zero = False

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of rate, site, mode and marks."""
        does: dict[str, Callable[[], None]] = {
            "left": partial(self._turn_rate, -_STEP_HZ),
            "right": partial(self._turn_rate, _STEP_HZ),
            "[": partial(self._turn_site, -1),
            "]": partial(self._turn_site, 1),
            "m": self._next_mode,
        }
        does |= {str(mark): partial(self._changed, "mark", mark) for mark in range(1, 10)}
        return {key: partial(self._asked.append, act) for key, act in does.items()}

    @property
    def amplitude_ma(self) -> float:
        """Amplitude set by the user, of the strongest electrode, mA."""
        return float(self._full_ma[self.site]) * (self._level or 0.0)

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the next pulse."""
        self._now_ns = time_ns
        while self._asked:
            self._asked.popleft()()
        level, self._from_zero = (0.0 if self._from_zero else 1.0), False
        activation = np.zeros((len(Afferent), len(self._profile.electrodes)), np.float32)
        activation[self.afferent, self.site] = 1
        self.frames += 1
        period_us, number = round(1e6 / self.rate_hz), self.frames - 1
        return Stimulus(activation, time_ns, self._press_n, period_us, level, number=number)

    def step(self, result: StepResult) -> None:
        """Log the delivered step and the change of amplitude by hand."""
        current_ua = result.step.sequence.current_ua
        self._current_ma = float(np.abs(current_ua).max(initial=0)) / 1000
        self._force_n = result.step.input.force_n
        if result.step.level != self._level:
            self._level = result.step.level
            self._changed("amplitude", round(self.amplitude_ma, 3))
        self.title: str = (
            f"{self.afferent.name}, site {self.site}, {self.rate_hz:g} Hz, "
            f"{self.amplitude_ma:.2f} mA asked for, {self._current_ma:.2f} mA flow"
        )

    def _turn_rate(self, by_hz: float) -> None:
        self.rate_hz = min(self._fastest_hz, max(SLOWEST_HZ, self.rate_hz + by_hz))
        self._changed("rate", self.rate_hz)

    def _turn_site(self, by: int) -> None:
        self.site = self._sites[(self._sites.index(self.site) + by) % len(self._sites)]
        self._from_zero = True
        self._changed("site", self.site)

    def _next_mode(self) -> None:
        place = self._offered.index(self.afferent)
        self.afferent = self._offered[(place + 1) % len(self._offered)]
        self._from_zero = True
        self._changed("mode", self.afferent.name)

    def _changed(self, what: str, value: object) -> None:
        self.emit(Note(self._now_ns, f"{what} {value}"))
        self._log.write(
            (
                round(self._now_ns / 1e9, 6), what, value, round(self.amplitude_ma, 3),
                self._current_ma, self.rate_hz, self.afferent.name, self.site,
                round(self._force_n, 3),
            )
        )  # fmt: skip
