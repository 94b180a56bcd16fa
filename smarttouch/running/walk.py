"""Pulses on one electrode after another, while someone feels or watches."""

import contextlib
import math
from collections.abc import Generator, Iterable, Sequence
from typing import ClassVar

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import BoardError, SmartTouchError, require_within
from smarttouch.base.events import Note
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import Board
from smarttouch.kernels.bank import single_bank
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.runner import Runner
from smarttouch.running.step import Listener, RunContext
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Stimulus, StimulusSource

PATIENCE = 4  # longest wait at an electrode for its first pulse, in units of the time for each


class ElectrodeReached(Note):
    """The walk reached an electrode."""


class Walk(StimulusSource, Listener):
    """Pulses on one electrode after another; on each, current rises from zero.

    Each electrode gets ``current_ma`` against all others, for ``seconds`` or until `go_on`; masked
    ones are left out. By the board's report those in ``pulsed`` got a pulse, and those in
    ``missed``, which it reached too, got none.
    """

    frames: int

    ended: ClassVar[str] = "all electrodes are tried"
    knows_force = True

    def __init__(
        self,
        profile: Profile,
        current_ma: float,
        seconds: float | None = None,
        sites: Sequence[int] | None = None,
    ) -> None:
        super().__init__("one electrode after another")
        if seconds is not None:
            words = f"{seconds:g} s for each electrode"
            require_within(SmartTouchError, "seconds", seconds, 0, math.inf, words, above=True)
        full_ma = float(profile.full_ma.max())
        words = f"{current_ma:g} mA, where {full_ma:g} mA are the strongest comfortable current,"
        require_within(SmartTouchError, "current_ma", current_ma, 0, full_ma, words, above=True)
        self.pulsed: list[int] = []
        self.missed: list[int] = []
        self._board: Board | None = None
        self._delivered = self._now_ns = 0
        self._profile, self._current_ma, self._seconds = profile, current_ma, seconds
        self._sites = range(len(profile.electrodes)) if sites is None else sites
        self._leaves = False
        self._stimuli = self._walk()

    def start(self, run: RunContext) -> None:
        self._board = run.board

    def go_on(self) -> None:
        """Leave the present electrode; from any thread."""
        self._leaves = True

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the next pulse; None after the last electrode."""
        self._now_ns = time_ns
        return next(self._stimuli, None)

    def _walk(self) -> Generator[Stimulus, None, None]:
        how = "any key: next, q: end" if self._seconds is None else f"{self._seconds:g} s"
        for site in self._sites:
            # Not above what is comfortable there.
            most_ma = min(self._current_ma, float(self._profile.full_ma[site]))
            masked = site in self._profile.output.masked
            words = "masked" if masked else f"up to {most_ma:.4g} mA ({how})"
            self.emit(ElectrodeReached(self._now_ns, f"electrode {site}: {words}"))
            if masked:
                continue
            self.missed.append(site)
            self._leaves, began_ns = False, self._now_ns
            # From zero: intensity rises no faster than the ramp.
            yield self._pulse(site, 0.0)
            # By now all that was sent for the electrode before has flowed.
            slots = self._slots()
            while True:
                if site in self.missed and self._slots() > slots:
                    self.missed.remove(site)
                    self.pulsed.append(site)
                # A board that was switched off meanwhile counts from zero again.
                slots = min(slots, self._delivered)
                # By the time of what was sent: a computer that stood still has tried nothing.
                most_s = (self._seconds or math.inf) * (PATIENCE if site in self.missed else 1)
                if self._leaves or self._now_ns - began_ns >= most_s * 1e9:
                    break
                yield self._pulse(site, most_ma)

    def _slots(self) -> int:
        """Return how many slots the board has delivered, as far as it has said so."""
        # Whatever keeps it from that is raised by the next send.
        with contextlib.suppress(BoardError):
            if self._board is not None:
                self._delivered = self._board.report().slots
        return self._delivered

    def _pulse(self, site: int, current_ma: float) -> Stimulus:
        profile = self._profile
        self.frames += 1
        activation = np.zeros((len(Afferent), len(profile.electrodes)), np.float32)
        activation[Afferent.RA, site] = 1
        return Stimulus(
            activation, self._now_ns, profile.force.full_n, round(1e6 / profile.pulse.rate_hz),
            current_ma / float(profile.full_ma[site]), number=self.frames - 1,
        )  # fmt: skip


def run_walk(
    walk: Walk,
    display: Display,
    listeners: Iterable[Listener],
    stop: StopRequest,
    force: ForceSource | str | None = None,
) -> None:
    """Run a walk, whose strength is an argument of its own; the arguments are those of `Runner`."""
    Runner(
        walk, display, RunConfig(scan="points", intensity=1.0), force=force, listeners=listeners,
        stop=stop, load_kernels=single_bank,
    ).run()  # fmt: skip
