"""A recording as pictures in any order, also while it is still being read."""

import json
import tempfile
import threading
import zlib
from array import array
from pathlib import Path
from typing import Any

from smarttouch.closing import Closing
from smarttouch.errors import RecordingError
from smarttouch.recording.reader import Recording
from smarttouch.window.pictures import array_message, picture_message

_LEVEL = 1
_STANDS_FOR = ("mode", "board", "sensor", "subject", "note")


class Tape(Closing):
    """Pictures of all steps of a recording, in a temporary file: ``times_s`` of those that have
    been read, and ``wrong`` for what could not be read."""

    def __init__(self, path: Path) -> None:
        self.recording = Recording(path)
        self.times_s = array("d")
        self.array = array_message(self.recording.profile)
        self._places = array("q", [0])
        self._events: list[dict[str, Any]] = []
        self._ended = self._closing = False
        self.wrong = ""
        self._file = tempfile.TemporaryFile(prefix="smarttouch-")  # noqa: SIM115
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._read, name="tape", daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self.times_s)

    def wait(self) -> None:
        """Wait until all has been read."""
        self._thread.join()

    def picture(self, index: int) -> bytes:
        """Return the picture of a step, JSON; raise IndexError if it does not exist or has not been
        read yet."""
        if not 0 <= index < len(self.times_s):
            raise IndexError(index)
        with self._lock:
            self._file.seek(self._places[index])
            return zlib.decompress(self._file.read(self._places[index + 1] - self._places[index]))

    def message(self, first: int = 0) -> dict[str, Any]:
        """Return what a page needs beside pictures; times from a step on."""
        recording = self.recording
        settings = {key: str(recording.settings.get(key) or "") for key in _STANDS_FOR}
        return {
            "name": recording.path.name,
            "array": self.array,
            "started": recording.started.isoformat(timespec="seconds"),
            "duration_s": recording.duration_s,
            "told": {key: each for key, each in settings.items() if each},
            "times_s": self.times_s[first:].tolist(),
            "events": self._events,
            "ended": self._ended,
            "wrong": self.wrong,
        }

    def close(self) -> None:
        self._closing = True
        self._thread.join()
        self._file.close()

    def _read(self) -> None:
        try:
            for recorded in self.recording.steps():
                if self._closing:
                    return
                data = zlib.compress(json.dumps(picture_message(recorded.sent)).encode(), _LEVEL)
                with self._lock:
                    self._file.seek(self._places[-1])
                    self._file.write(data)
                self._places.append(self._places[-1] + len(data))
                self.times_s.append(recorded.step.input.time_ns / 1e9)
            self._events = [
                {"time_s": time_ns / 1e9, "text": words}
                for time_ns, words in self.recording.events()
            ]
            if not self.recording.whole:
                self.wrong = "it is cut or damaged: what can be read of it is shown"
        except (RecordingError, OSError) as error:
            self.wrong = str(error)
        self._ended = True
