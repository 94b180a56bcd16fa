"""Server for Foxglove: the topics of a recording, live, with the same schemas."""

import json
import threading
import time
from collections import deque
from typing import Any

from smarttouch.errors import SmartTouchError
from smarttouch.events import Event
from smarttouch.realtime import prioritized
from smarttouch.recording.encoder import StepEncoder
from smarttouch.recording.schemas import SCHEMAS, schema
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult

MOST_HZ = 60
_JOIN_S = 1.0
_EVENTS = 1000


class FoxgloveServer(Listener):
    """Shows a run in Foxglove by a server at 127.0.0.1; port 0 is a free one. It controls nothing.

    The loop's thread only leaves the newest step for the server's own.
    """

    def __init__(self, port: int) -> None:
        super().__init__()
        self._foxglove, self.port = _import_foxglove(), port
        self._latest: StepResult | None = None
        self._events: deque[tuple[int, str]] = deque(maxlen=_EVENTS)
        self._over = threading.Event()
        self._server: Any = None
        self._thread: threading.Thread | None = None

    def prepare(self, run: RunContext) -> None:
        """Begin to serve."""
        foxglove = self._foxglove
        # Its channels are gone with it.
        self._context = context = foxglove.Context()
        self._started_unix_ns = time.time_ns()
        self._encoder = StepEncoder(self._started_unix_ns, run.profile.electrodes)
        self._channels = {
            topic: foxglove.Channel(
                topic,
                schema=foxglove.Schema(
                    name=name, encoding="jsonschema", data=json.dumps(schema(topic)).encode()
                ),
                message_encoding="json",
                context=context,
            )
            for topic, (name, _) in SCHEMAS.items()
        }
        try:
            self._server = foxglove.start_server(
                name=run.source.title, host="127.0.0.1", port=self.port, context=context
            )
        except (RuntimeError, OSError, OverflowError) as error:
            raise SmartTouchError(
                f"Foxglove cannot have port {self.port}: {error}; give another one",
                about="foxglove",
                remedy="foxglove",
            ) from None
        self.port = self._server.port
        self._thread = threading.Thread(target=self._serve, name="foxglove", daemon=True)
        self._thread.start()

    def step(self, result: StepResult) -> None:
        """Keep the newest."""
        self._latest = result

    def event(self, event: Event) -> None:
        """Keep an event until it is sent."""
        self._events.append((event.time_ns, str(event)))

    def close(self) -> None:
        """Send what is left, and serve no more."""
        self._over.set()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
            self._server.stop()
            self._thread = None

    # Whoever holds the interpreter at a lower priority would hold up the loop, which waits for it.
    @prioritized()
    def _serve(self) -> None:
        shown: StepResult | None = None
        while True:
            over = self._over.wait(1 / MOST_HZ)
            while self._events:
                time_ns, words = self._events.popleft()
                self._log("/event", self._encoder.event(time_ns, words), time_ns)
            latest = self._latest
            if latest is not None and latest is not shown:
                shown = latest
                for topic, message in self._encoder.messages(latest):
                    self._log(topic, message, latest.input.time_ns)
            if over:
                return

    def _log(self, topic: str, message: dict[str, Any], time_ns: int) -> None:
        self._channels[topic].log(message, log_time=self._started_unix_ns + time_ns)


def _import_foxglove() -> Any:
    try:
        import foxglove
    except ImportError:
        raise SmartTouchError(
            "Foxglove needs the extra foxglove: pip install 'smarttouch[foxglove]'",
            about="foxglove",
            remedy="pip install 'smarttouch[foxglove]'",
        ) from None
    return foxglove
