"""A simulated finger's response during a run, in a process of its own that never delays it."""

import contextlib
import os
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.posix import fcntl
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import Feeling, fire_all
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.running.delivered import DeliveredSlots
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult

_SERVE = "import sys; from smarttouch.views.live_finger import serve; serve(int(sys.argv[1]))"
_POLITE = 5  # niceness during a run: the sending of packets goes first
MOST_RECENT = 64  # steps that one response is to, at most
_ENDS_WITHIN_S = 5.0


class LiveFinger(Listener):
    """Simulates a finger's response to the newest step of a run whenever the one before is done.

    The loop never waits: it hands a step only to an idle process. A thread would not do, as it
    could be held up while it has the interpreter. ``simulated`` and ``skipped`` count steps that
    were simulated, and that came meanwhile. With ``over_s``, the response is that to all steps of
    the last ``over_s``.
    """

    def __init__(self, finger: Finger, *, over_s: float = 0.0) -> None:
        super().__init__()
        self.newest: Feeling | None = None
        self.simulated: int = 0
        self.skipped: int = 0
        self.finger: Finger = finger
        self._line: Connection | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self.felt: StepResult | None = None  # the newest step of the response
        self._recent: deque[StepResult] = deque(maxlen=MOST_RECENT)
        self._over_ns = round(over_s * 1e9)
        self._begun: StepResult | None = None
        self._given: Feeling | None = None  # what the process is at, without its spikes

    def prepare(self, run: RunContext) -> None:
        """Start the process, and wait until it has computed what drives its afferents."""
        if fcntl is None:
            raise SmartTouchError(
                "a finger is simulated during a run on POSIX systems alone: make it from the "
                "recording later"
            )
        ours, theirs = socket.socketpair()
        with theirs:
            command = [sys.executable, "-c", _SERVE, str(theirs.fileno())]
            environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
            self._process = subprocess.Popen(
                command, pass_fds=[theirs.fileno()], env=environment, stdin=subprocess.DEVNULL
            )
        self._line = Connection(ours.detach())
        with self._alive() as line:
            line.send(self.finger)
        self._receive()

    def step(self, result: StepResult) -> None:
        """Take a finished response, and hand over a step if the process is idle."""
        self._recent.append(result)
        while result.input.time_ns - self._recent[0].input.time_ns >= max(1, self._over_ns):
            self._recent.popleft()
        assert self._line is not None
        if self._given is not None and self._line.poll():
            self._take()
        if self._given is not None:
            self.skipped += 1
            return
        recent = [each.sequence for each in (self._recent if self._over_ns else [result])]
        active = np.asarray(result.tactile.activation.any(axis=0))
        self._given = Feeling(self.finger, (), active, result.step.mode.afferents)
        self._begun = result
        with self._alive() as line:
            line.send([DeliveredSlots.of(each) for each in recent])

    def finish(self, run: RunContext) -> None:
        """Take the last response: the board is closed."""
        if self._given is not None:
            self._take()

    def close(self) -> None:
        line, process = self._line, self._process
        self._line = self._process = self._given = None
        if line is not None:
            line.close()
        if process is not None:
            try:
                process.wait(_ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def abandon(self) -> None:
        """Kill the process, from any thread."""
        process = self._process
        if process is not None:
            process.kill()

    def _take(self) -> None:
        assert self._given is not None
        self.newest = Feeling(self.finger, self._receive(), self._given.active, self._given.wanted)
        self._given, self.felt = None, self._begun
        self.simulated += 1

    def _receive(self) -> Any:
        with self._alive() as line:
            return line.recv()

    @contextlib.contextmanager
    def _alive(self) -> Iterator[Connection]:
        assert self._line is not None
        try:
            yield self._line
        except (EOFError, OSError):
            raise SmartTouchError(
                "the process that simulates the finger has ended: see its messages, and run again"
            ) from None


def serve(number: int) -> None:
    """Simulate responses to slots from a socket until it is closed."""
    with Connection(number) as line:
        finger = line.recv()
        model = SpikeModel(finger)
        os.nice(_POLITE)  # the run waits until here
        line.send(None)
        while True:
            try:
                slots = line.recv()
            except (EOFError, OSError):
                return
            model.reset()
            line.send(tuple(fire_all(model, slots)))
