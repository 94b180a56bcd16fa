"""A recording as pictures: indexed while it is read, written as PNG, SVG and MP4."""

import base64
import contextlib
import json
import tempfile
import threading
import zlib
from array import array
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Mode
from smarttouch.base.array_picture import Colors, ElectrodePicture, current_colors, electrodes_svg
from smarttouch.base.electrodes import ElectrodeArray
from smarttouch.base.errors import DesignError, RecordingError
from smarttouch.base.files import owner_only, unwritable
from smarttouch.base.stopping import Closing
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import Feeling, fire_all
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import Profile
from smarttouch.running.delivered import DeliveredSlots
from smarttouch.running.recording_reader import Recording
from smarttouch.sources.source_contract import Pose
from smarttouch.views.window_messages import (
    Message,
    array_message,
    finger_message,
    picture_message,
    response_message,
)

SIMULATED = (1, "branched")  # seed and anatomy of the finger of responses
SPIKES_OVER_S = 0.1
_LEVEL = 1
_STANDS_FOR = ("mode", "board", "sensor", "subject", "note")


class RecordingIndex(Closing):
    """Pictures of all steps of a recording, in a temporary file: ``times_s`` of those that have
    been read, and ``wrong`` for what could not be read."""

    def __init__(self, path: Path) -> None:
        self.recording: Recording = Recording(path)
        self.times_s: array[float] = array("d")
        self.array: Message = array_message(self.recording.profile)
        self.finger: Finger | None = None
        """The simulated finger of responses; None if none can be made of the profile."""
        with contextlib.suppress(DesignError):
            self.finger = Finger(self.recording.profile, *SIMULATED)
        self._series: list[tuple[float, float, float | None]] = []
        self._model: SpikeModel | None = None
        self._feeling = threading.Lock()
        self._poses: list[tuple[float, float]] = []
        self._places = array("q", [0])
        self._events: list[dict[str, Any]] = []
        self._ended = self._closing = False
        self.wrong: str = ""
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

    def response(self, index: int) -> bytes:
        """Return the finger's response to the steps of `SPIKES_OVER_S` up to one, JSON; raise
        IndexError if there is no such step, or no finger."""
        if not 0 <= index < len(self.times_s) or self.finger is None:
            raise IndexError(index)
        first, until_s = index, self.times_s[index]
        while first and until_s - self.times_s[first - 1] < SPIKES_OVER_S - 1e-9:
            first -= 1
        steps = [json.loads(self.picture(each)) for each in range(first, index + 1)]
        electrodes = len(self.recording.profile.electrodes)
        slots = [_slots(each, electrodes, self.finger.profile) for each in steps]
        site = np.array(steps[-1]["site"], np.intp)
        active = np.zeros(electrodes, np.bool_)
        active[site[(site >= 0) & (site < electrodes)]] = True
        wanted = Mode(steps[-1]["mode"]).afferents
        with self._feeling:
            self._model = self._model or SpikeModel(self.finger)
            self._model.reset()
            spikes = tuple(fire_all(self._model, slots))
        x_mm, y_mm, angle_rad = steps[-1]["pose"]
        pose = Pose(x_mm, y_mm, angle_rad)
        return json.dumps(
            response_message(Feeling(self.finger, spikes, active, wanted), pose)
        ).encode()

    def message(self, first: int = 0) -> dict[str, Any]:
        """Return what a page needs beside pictures; times from a step on."""
        recording = self.recording
        settings = {key: str(recording.settings.get(key) or "") for key in _STANDS_FOR}
        return {
            "name": recording.path.name,
            "array": self.array,
            "started": recording.started.isoformat(timespec="seconds"),
            "duration_s": recording.duration_s,
            "facts": {key: each for key, each in settings.items() if each},
            "times_s": self.times_s[first:].tolist(),
            "series": self._series[first : len(self.times_s)],
            "sheet": self._sheet(),
            "finger": None if self.finger is None else finger_message(self.finger),
            "events": self._events,
            "ended": self._ended,
            "wrong": self.wrong,
        }

    def _sheet(self) -> Message:
        """Return the area that the finger passed over."""
        poses = np.array([*self._poses] or [(0.0, 0.0)])
        field_mm = np.array(self.array["field_mm"])
        corner_mm = poses.min(axis=0) - field_mm
        size_mm = np.ptp(poses, axis=0) + 2 * field_mm
        return {"number": 0, "size_mm": size_mm.tolist(), "corner_mm": corner_mm.tolist()}

    def close(self) -> None:
        self._closing = True
        self._thread.join()
        self._file.close()

    def _read(self) -> None:
        try:
            for recorded in self.recording.steps():
                if self._closing:
                    return
                picture = picture_message(recorded.sent)
                data = zlib.compress(json.dumps(picture).encode(), _LEVEL)
                with self._lock:
                    self._file.seek(self._places[-1])
                    self._file.write(data)
                self._places.append(self._places[-1] + len(data))
                self._poses.append((picture["pose"][0], picture["pose"][1]))
                self._series.append((picture["peak_ma"], picture["charge_uc"], picture["force_n"]))
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


def _slots(picture: dict[str, Any], electrodes: int, profile: Profile) -> DeliveredSlots:
    current_ua = np.frombuffer(base64.b64decode(picture["current_ua"]), "<i2")
    width_us = np.array(picture["width_us"], np.uint16)
    discharge_us = np.full(len(width_us), profile.pulse.discharge_us, np.uint16)
    current_ua = current_ua.reshape(-1, electrodes).astype(np.int16)
    return DeliveredSlots(current_ua, width_us, discharge_us, picture["period_us"])


KINDS = (".png", ".svg", ".mp4")
FILM_HZ = 25
MOST_FILM_S = 600
_PX_PER_MM = 24
_MOST_PX = 720
_CODEC = "vp09"  # browsers play it, and OpenCV includes it

Current = NDArray[np.int16]


def shown_current(picture: dict[str, Any], electrodes: int, slot: int | None) -> Current:
    """Return the current of each electrode in a slot, or the strongest of all, (E,) µA."""
    current = np.frombuffer(base64.b64decode(picture["current_ua"]), "<i2")
    current = current.reshape(-1, electrodes)
    if slot is not None:
        return np.asarray(current[slot])
    if not len(current):
        return np.zeros(electrodes, np.int16)
    strongest = np.abs(current.astype(np.int32)).argmax(axis=0)
    return np.asarray(np.take_along_axis(current, strongest[None], axis=0)[0])


def export_view(tape: RecordingIndex, index: int, kind: str, slot: int | None = None) -> bytes:
    """Return a view of a step, a slot of it or the strongest of all, as ``.png`` or ``.svg``."""
    electrodes = tape.recording.profile.electrodes
    current = shown_current(json.loads(tape.picture(index)), len(electrodes), slot)
    colors = current_colors(current, tape.array["full_ma"])
    if kind == ".svg":
        titles = (f"electrode {number}: {ua / 1000:g} mA" for number, ua in enumerate(current))
        return electrodes_svg(electrodes, colors, titles).encode()
    image = _picture(electrodes).raster(colors)
    _, png = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return png.tobytes()


def _picture(electrodes: ElectrodeArray) -> ElectrodePicture:
    return ElectrodePicture(electrodes, min(_PX_PER_MM, _MOST_PX / max(electrodes.extent_mm)))


def export_film(
    tape: RecordingIndex,
    path: Path,
    first: int = 0,
    last: int | None = None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
) -> None:
    """Write a range of steps as a film (``.mp4``) in real time."""
    # A copy: the recording may still be being read, and it grows.
    times = np.array(tape.times_s[first : None if last is None else last + 1])
    if not len(times):
        raise IndexError(first)
    seconds = float(times[-1] - times[0])
    if seconds > MOST_FILM_S:
        raise RecordingError(
            f"a film of {seconds:.0f} s is longer than {MOST_FILM_S}: choose fewer steps",
            about="film",
        )
    count = max(1, round(seconds * FILM_HZ))
    at_s = times[0] + np.arange(count) / FILM_HZ
    indices = first + np.searchsorted(times, at_s + 1e-9, side="right") - 1
    _write_film(path, _pictures(tape, indices.tolist()), advance, count)


def _pictures(tape: RecordingIndex, indices: Iterable[int]) -> Iterable[Colors]:
    electrodes = tape.recording.profile.electrodes
    picture = _picture(electrodes)
    for index in indices:
        current = shown_current(json.loads(tape.picture(index)), len(electrodes), None)
        yield picture.raster(current_colors(current, tape.array["full_ma"]))


def _write_film(
    path: Path,
    pictures: Iterable[NDArray[np.uint8]],
    advance: Callable[[int, int], None],
    count: int,
) -> None:
    writer: cv2.VideoWriter | None = None
    try:
        for done, picture in enumerate(pictures, 1):
            height, width = picture.shape[:2]
            if writer is None:
                with open(path, "wb", opener=owner_only):
                    pass
                code = cv2.VideoWriter.fourcc(*_CODEC)
                writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, FILM_HZ, (width, height))
                if not writer.isOpened():
                    raise RecordingError(
                        f"cannot write {path}: see whether its folder is there and may be written "
                        "to, and that this OpenCV writes VP9",
                        about="file",
                    )
            writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
            advance(done, count)
    except OSError as error:
        raise unwritable(RecordingError, path, error) from None
    finally:
        if writer is not None:
            writer.release()
