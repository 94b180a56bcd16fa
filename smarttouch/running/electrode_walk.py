"""Electrode sweep: pulses on one electrode after another, to feel or watch."""

import math
from collections.abc import Sequence
from typing import Any, ClassVar

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SmartTouchError, require_within
from smarttouch.base.events import Note
from smarttouch.kernels.bank import single_bank
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.pattern_program import Program
from smarttouch.running.runner import Runner


class ElectrodeReached(Note):
    """Event: the electrode sweep has reached the next electrode."""


class Walk(Program):
    """Program that drives one electrode after another, with a current that rises from zero.

    A current of at most ``current_ma`` flows between the electrode and all others. The next
    electrode follows after ``seconds`` or a call of `go_on`. Masked electrodes are skipped.
    """

    fixed_mode: ClassVar[bool] = True
    ended: ClassVar[str] = "all electrodes have been tried"

    def __init__(
        self,
        profile: Profile,
        current_ma: float,
        seconds: float | None = None,
        sites: Sequence[int] | None = None,
    ) -> None:
        super().__init__(profile, "one electrode after another")
        if seconds is not None:
            words = f"the requested time of {seconds:g} s for each electrode"
            require_within(SmartTouchError, "seconds", seconds, 0, math.inf, words, above=True)
        full_ma = float(profile.full_ma.max())
        words = f"the requested current of {current_ma:g} mA (comfortable: up to {full_ma:g} mA)"
        require_within(SmartTouchError, "current_ma", current_ma, 0, full_ma, words, above=True)
        self._leaves, self._current_ma, self._seconds = False, current_ma, seconds
        self._sites = range(len(profile.electrodes)) if sites is None else sites

    def go_on(self) -> None:
        """Go to the next electrode. Any thread may call this."""
        self._leaves = True

    def program(self) -> None:
        how = "any key: next, q: end" if self._seconds is None else f"{self._seconds:g} s"
        each_ns = 1e9 * (self._seconds or math.inf)
        period_us = round(1e6 / self._profile.pulse.rate_hz)
        with self._turn():
            for site in self._sites:
                # Limit the current to the comfort level of the electrode.
                most_ma = min(self._current_ma, float(self._profile.full_ma[site]))
                masked = site in self._profile.output.masked
                words = "masked" if masked else f"up to {most_ma:.4g} mA ({how})"
                self.emit(ElectrodeReached(self.now_ns, f"electrode {site}: {words}"))
                if masked:
                    continue
                activation, level = self._nothing.copy(), 0.0
                activation[Afferent.RA, site] = 1
                self._leaves, began_ns = False, self.now_ns
                # Count the durations of the sent sequences, without pauses of the computer.
                while not level or (not self._leaves and self.now_ns - began_ns < each_ns):
                    self._count += 1
                    self._send(self._stimulus(activation, period_us, level))
                    # The first sequence is at zero. Then the ramp limits how fast intensity rises.
                    level = float(most_ma / self._profile.full_ma[site])


def run_walk(walk: Walk, display: Display, **options: Any) -> None:
    """Run a sweep at full intensity; ``options`` are passed to `Runner`."""
    config = RunConfig(scan="points", intensity=1.0)
    Runner(walk, display, config, load_kernels=single_bank, **options).run()
