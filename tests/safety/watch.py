"""Watch, which lets the oracle judge each sequence that a gate of this process accepts."""

import functools
import inspect
from copy import copy
from pathlib import Path
from weakref import WeakKeyDictionary

import pytest

from smarttouch.boards.board import Board
from smarttouch.emulator.drivers import SimulatedDriver
from smarttouch.emulator.firmware_base import DELIVERED_FILE, STATE_FILE
from smarttouch.profile import list_profiles, load_profile
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits

from .bounds import Bounds
from .delivery_judge import Pulses, judge_pulses
from .oracle import Oracle

OF_PROFILE = "bounds of its profile"
"""Name of the attribute in which a `SafetyLimits` holds the `Bounds` of its profile."""


class HeardClock:
    """Clock that remembers the time it last returned."""

    def __init__(self, clock):
        self._clock, self.heard_ns = clock, 0

    def now_ns(self):
        self.heard_ns = self._clock.now_ns()
        return self.heard_ns

    def __getattr__(self, name):
        return getattr(self._clock, name)


class Watch:
    """Check of sequences that gates of this process accept, and of pulses that boards deliver.

    ``broken`` has a message for each failure since the last `take`. If ``on`` is false, nothing is
    checked, so that tests can measure time.
    """

    def __init__(self):
        self.broken, self.on = [], True
        self._seen, self._of_profile = {}, {}
        self._oracles, self._clocks = WeakKeyDictionary(), WeakKeyDictionary()
        self._limits, self._proved_sequences = WeakKeyDictionary(), WeakKeyDictionary()

    def bounds_of(self, limits):
        """Return the bounds of a `SafetyLimits`, if possible from the profile it was made from."""
        bounds = vars(limits).get(OF_PROFILE) or Bounds.of_limits(limits)
        self._seen[bounds.electrodes] = bounds
        return bounds

    def bounds_of_size(self, electrodes):
        """Return the bounds of the display with this number of electrodes that the test used last;
        otherwise those of a shipped profile of this size, or None."""
        if electrodes in self._seen:
            return self._seen[electrodes]
        for name in list_profiles():
            if len(load_profile(name).electrodes) == electrodes:
                return Bounds.of(load_profile(name))
        return None

    def take(self):
        """Return the messages in ``broken``, and forget them and the displays of this test."""
        self._seen.clear()
        taken, self.broken = self.broken, []
        return taken

    def judge(self, gate, sequence, times=1):
        """Judge a sequence that a gate has accepted."""
        if not self.on:
            return
        oracle = self._oracles.get(gate)
        if oracle is None:
            oracle = self._oracles[gate] = Oracle(self.bounds_of(gate.limits))
        clock = self._clocks.get(gate)
        # A gate without a clock uses the times stated in sequences.
        now_ns = sequence.time_ns if clock is None else clock.heard_ns
        broken = oracle.judge(sequence, now_ns, times, written=False)
        if not broken:
            self._proved_sequences[sequence] = oracle.newest
        if broken:
            self.broken.append(f"a gate accepted {sequence}, which breaks {', '.join(broken)}")

    def begin(self, gate):
        """Discard the oracle of a gate, because the board of the gate starts a session."""
        self._oracles.pop(gate, None)

    def restart(self, gate):
        """Restart the oracle of a gate at zero, as the gate does. The session's dose remains."""
        oracle, clock = self._oracles.get(gate), self._clocks.get(gate)
        if oracle is not None and clock is None:
            oracle.restart(oracle.clock_ns or 0)
        elif oracle is not None:
            oracle.restart(clock.heard_ns)

    def judge_taken(self, driver, pulses):
        """Judge pulses that a simulated board has delivered."""
        if self.on and driver in self._limits:
            bounds = self.bounds_of(self._limits[driver])
            self._delivered(Pulses.taken(*pulses), bounds, "simulated:")

    def judge_books(self, root):
        """Judge all delivery logs in a folder, with the bounds that `bounds_of_size` returns."""
        for delivered in sorted(Path(root).rglob(DELIVERED_FILE)):
            if (delivered.parent / STATE_FILE).is_file():
                pulses = Pulses.of_books(delivered.parent)
                bounds = self.bounds_of_size(pulses.current_ua.shape[1])
                if bounds is not None:
                    self._delivered(pulses, bounds, str(delivered.parent))

    def _delivered(self, pulses, bounds, where):
        if broken := judge_pulses(pulses, bounds):
            self.broken.append(f"{where} delivered pulses that break {', '.join(broken)}")

    # -- patches of the package -----------------------------------------------

    def installed(self):
        """Patch gates and boards to report to this watch; return the patch, which can be undone."""
        patch = pytest.MonkeyPatch()
        patch.setattr(SafetyLimits, "of", classmethod(self._of(SafetyLimits.of.__func__)))
        patch.setattr(SafetyGate, "__init__", self._made(SafetyGate.__init__))

        def judge(gate, proved, *_, **__):
            self.judge(gate, proved.sequence, proved.times)

        def note(gate, _, proved):
            sent = self._proved_sequences.pop(proved.sequence, None)
            if sent is not None and (oracle := self._oracles.get(gate)) is not None:
                clock = self._clocks.get(gate)
                oracle.wrote(sent, proved.sequence.time_ns if clock is None else clock.heard_ns)

        def rest(driver, _):
            # Take the pulses from a copy, so that the test can still take them.
            self.judge_taken(driver, copy(driver._books).take())

        def made(board, _, driver, *__, **___):
            self._limits[driver] = board._gate.limits

        for kind, name, do in (
            (SafetyGate, "prove", judge),
            (SafetyGate, "note", note),
            (SafetyGate, "restart", lambda gate, _: self.restart(gate)),
            (SafetyGate, "begin_session", lambda gate, _: self.begin(gate)),
            (SimulatedDriver, "take_pulses", self.judge_taken),
            (SimulatedDriver, "close", rest),
            (Board, "__init__", made),
        ):
            patch.setattr(kind, name, _then(getattr(kind, name), do))
        return patch

    def _of(self, of):
        @functools.wraps(of)
        def watched(kind, profile):
            limits = of(kind, profile)
            key = profile.model_dump_json()
            if key not in self._of_profile:
                self._of_profile[key] = Bounds.of(profile)
            bounds = vars(limits)[OF_PROFILE] = self._of_profile[key]
            self._seen[bounds.electrodes] = bounds
            return limits

        return watched

    def _made(self, init):
        signature = inspect.signature(init)

        @functools.wraps(init)
        def watched(gate, *given, **named):
            bound = signature.bind(gate, *given, **named)
            if bound.arguments.get("clock") is not None:
                self._clocks[gate] = HeardClock(bound.arguments["clock"])
                bound.arguments["clock"] = self._clocks[gate]
            init(*bound.args, **bound.kwargs)

        return watched


def _then(call, do):
    """Return a method that calls ``call``, and then ``do`` with the returned value."""

    @functools.wraps(call)
    def watched(owner, *given, **named):
        returned = call(owner, *given, **named)
        do(owner, returned, *given, **named)
        return returned

    return watched
