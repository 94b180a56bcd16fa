"""Activations that other programs send: the newest wins, and wakes the loop."""

import threading
from abc import abstractmethod
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.profile import Profile
from smarttouch.running.session_feed import SessionFeed
from smarttouch.sources.source_contract import Input, Stimulus

SILENT_S = 0.5  # silence after which an activation is stale
LOOK_S = 0.1  # longest wait of the receiving thread, which then looks whether it is to end
_JOIN_S = 1.0


class PushedStimuli(SessionFeed):
    """Source of activations that arrive by themselves; half a second of silence is an empty one.

    One that follows none or an empty one is read at once, the others with the next sequence, and
    pulses keep the profile's rates. With ``follow``, and where all three classes are driven, which
    have no rates of their own, each is read at once, in as far as the profile's limit allows, and
    is one pulse of every active class; the last is repeated at the profile's rate until it is
    stale.
    """

    fixed_mode = True
    stands_still = False
    ended = "the source has ended"

    def __init__(self, title: str, profile: Profile, follow: bool = False) -> None:
        super().__init__(profile, title)
        self.given: int = 0  # number of activations that came so far
        self.wrong: int = 0  # number of those that were left out, as they were invalid
        self._follow, self._closing = follow, False
        self._thread = threading.Thread(target=self._receive_all, name="received", daemon=True)
        self.put(np.zeros((len(Afferent), len(profile.electrodes)), np.float32), 0)
        self._put_sent_ns = 0

    @abstractmethod
    def receive(self) -> None:
        """Wait for at most `LOOK_S`, and `push` what has come; called by a thread of its own."""

    def _receive_all(self) -> None:
        while not self._closing:
            self.receive()

    def close(self) -> None:
        self._closing = True
        self._thread.join(_JOIN_S)

    def _note_wrong(self, words: str) -> None:
        """Add a note on how many were left out, and why."""
        if self.wrong:
            self.notes.append(f"{self.wrong} {words}")
            self.wrong = 0

    def push(self, activation: NDArray[np.float32]) -> None:
        """Take an activation, (3, E) in [0, 1], that is not written to again."""
        self.put(activation, round(1e9 * SILENT_S))
        self.given += 1

    @property
    def follows(self) -> bool:
        """Whether each begins at once."""
        return self._follow or len(self.afferents) == len(Afferent)

    def read(self, time_ns: int) -> Input | None:
        """Return what came last, of the classes that are driven; stale after a silence."""
        given = super().read(time_ns)
        if not isinstance(given, Stimulus):
            return given
        driven, rows = np.zeros_like(given.activation), list(self.afferents)
        driven[rows] = given.activation[rows]
        return replace(given, activation=driven)
