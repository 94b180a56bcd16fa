"""A run kept in one MCAP file: frames, force, tactile images, sequences, acknowledgments."""

import base64
import json
import queue
import threading
from pathlib import Path
from typing import Any, BinaryIO

from mcap.writer import Writer

from smarttouch.errors import RecordingError
from smarttouch.live import Sent

_NUMBER = {"type": "number"}
_INTEGER = {"type": "integer"}
_BYTES = {"type": "string", "contentEncoding": "base64"}
_TIME = {"type": "object", "properties": {"sec": _INTEGER, "nsec": _INTEGER}}

SCHEMAS: dict[str, tuple[str, dict[str, Any]]] = {
    "/frame": (
        "foxglove.RawImage",
        {
            "timestamp": _TIME,
            "frame_id": {"type": "string"},
            "width": _INTEGER,
            "height": _INTEGER,
            "encoding": {"type": "string"},
            "step": _INTEGER,
            "data": _BYTES,
        },
    ),
    "/finger": (
        "smarttouch.Finger",
        {"x_mm": _NUMBER, "y_mm": _NUMBER, "angle_rad": _NUMBER, "force_n": _NUMBER},
    ),
    "/tactile": (
        "smarttouch.TactileImage",
        {
            name: {"type": "array", "items": _NUMBER, "description": "activation per electrode"}
            for name in ("RA", "SAI", "PC")
        },
    ),
    "/sequence": (
        "smarttouch.ScanSequence",
        {
            "number": _INTEGER,
            "period_us": _INTEGER,
            "intensity": _NUMBER,
            "slots": _INTEGER,
            "electrodes": _INTEGER,
            "site": {"type": "array", "items": _INTEGER},
            "width_us": {"type": "array", "items": _INTEGER},
            "discharge_us": {"type": "array", "items": _INTEGER},
            "current_ua": {**_BYTES, "description": "int16 little endian (S, E), + cathodic"},
        },
    ),
    "/board": (
        "smarttouch.Acknowledgment",
        {"sent": _INTEGER, "acknowledged": _INTEGER, "refused": _INTEGER, "latency_us": _NUMBER},
    ),
}


class Recorder:
    """Writes a run to an MCAP file from a thread of its own.

    Parameters
    ----------
    path : Path
        The file; an existing one is not overwritten.
    about : dict of str to str
        Settings, profile and versions, kept as metadata.
    """

    def __init__(self, path: Path, about: dict[str, str]) -> None:
        try:
            self._file: BinaryIO = path.open("xb")
        except FileExistsError:
            raise RecordingError(
                f"{path} exists and recordings are never overwritten: give another name"
            ) from None
        except OSError as error:
            raise RecordingError(f"cannot record to {path}: {error.strerror}") from None
        self._path = path
        self._failure: OSError | None = None
        self._queue: queue.SimpleQueue[tuple[Sent, int, int] | None] = queue.SimpleQueue()
        self._writer = Writer(self._file, chunk_size=128 * 1024)
        self._writer.start(profile="smarttouch", library="smarttouch")
        self._writer.add_metadata("smarttouch", about)
        self._channels = {topic: self._register(topic) for topic in SCHEMAS}
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    def _register(self, topic: str) -> int:
        name, properties = SCHEMAS[topic]
        schema = {"title": name, "type": "object", "properties": properties}
        schema_id = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        return int(self._writer.register_channel(topic, "json", schema_id))

    def record(self, sent: Sent, acknowledged: int, refused: int) -> None:
        """Hand one frame over; the writing is done elsewhere."""
        self._queue.put((sent, acknowledged, refused))

    def close(self) -> None:
        """Write what is waiting, and finish the file.

        Raises
        ------
        RecordingError
            If the disk did not take all of it; what it took stays.
        """
        self._queue.put(None)
        self._thread.join()
        try:
            if self._failure is None:
                self._writer.finish()
            self._file.close()
        except OSError as error:
            self._failure = self._failure or error
        if self._failure is not None:
            raise RecordingError(
                f"{self._path} is cut short: {self._failure.strerror}; what was written is kept"
            )

    def _write_all(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._failure is None:
                try:
                    self._write(*item)
                except OSError as error:
                    self._failure = error

    def _write(self, sent: Sent, acknowledged: int, refused: int) -> None:
        frame, tactile, sequence = sent.step.frame, sent.step.tactile, sent.step.sequence
        height, width = frame.image.shape
        seconds, nanoseconds = divmod(frame.time_ns, 10**9)
        messages: dict[str, dict[str, Any]] = {
            "/frame": {
                "timestamp": {"sec": seconds, "nsec": nanoseconds},
                "frame_id": "sensor",
                "width": width,
                "height": height,
                "encoding": "mono8",
                "step": width,
                "data": _base64(frame.image.tobytes()),
            },
            "/finger": {
                "x_mm": frame.pose.x_mm,
                "y_mm": frame.pose.y_mm,
                "angle_rad": frame.pose.angle_rad,
                "force_n": frame.force_n,
            },
            "/tactile": {
                name: [round(float(value), 4) for value in row]
                for name, row in zip(("RA", "SAI", "PC"), tactile.activation, strict=True)
            },
            "/sequence": {
                "number": sent.number,
                "period_us": sequence.period_us,
                "intensity": sequence.intensity,
                "slots": sequence.slots,
                "electrodes": sequence.electrodes,
                "site": sequence.site.tolist(),
                "width_us": sequence.width_us.tolist(),
                "discharge_us": sequence.discharge_us.tolist(),
                "current_ua": _base64(sequence.current_ua.astype("<i2").tobytes()),
            },
            "/board": {
                "sent": sent.number,
                "acknowledged": acknowledged,
                "refused": refused,
                "latency_us": sent.latency_us,
            },
        }
        for topic, message in messages.items():
            self._writer.add_message(
                self._channels[topic],
                log_time=frame.time_ns,
                publish_time=frame.time_ns,
                data=json.dumps(message, separators=(",", ":")).encode(),
            )


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
