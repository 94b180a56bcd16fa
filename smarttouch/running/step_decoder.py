"""Decoder of messages into the steps of a run; invalid messages are left out."""

import base64
import json
import math
from collections import OrderedDict
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.tactile_image import TactileImage
from smarttouch.running.recording_format import LAST
from smarttouch.running.step import FirstPulse, Measured, Step, StepResult
from smarttouch.running.step_encoder import Message, remember
from smarttouch.sources.source_contract import Frame, Input, Pose, Stimulus
from smarttouch.stimulation.scan_sequence import ScanSequence, SelectivityReport

_IMPOSSIBLE = (ValueError, TypeError, LookupError, AttributeError, OverflowError, cv2.error)
"""Exceptions of messages that are valid JSON with invalid content."""
_LONGEST_US = 10_000_000  # longest time between two stimuli: the period of the slowest rate


@dataclass(frozen=True, eq=False)
class RecordedStep:
    """One recorded step of a run, by its number from 0; one missing in a file is not yielded.

    ``acknowledged`` and ``refused`` are of the whole run, as far as reported when it was sent.
    """

    index: int
    sent: StepResult
    acknowledged: int
    refused: int

    @property
    def step(self) -> Step:
        return self.sent.step


@dataclass
class StepDecoder:
    """Assembles steps from their messages, in the order of the file.

    ``broken`` counts steps that were incomplete or invalid.
    """

    electrodes: int
    broken: int = 0
    _index: int = -1
    _parts: dict[str, list[Message]] = field(default_factory=dict)
    _image: NDArray[np.uint8] | None = None
    _image_number: int = -1
    _sequences: OrderedDict[int, ScanSequence] = field(default_factory=OrderedDict)

    def take(self, topic: str, index: int, data: bytes) -> RecordedStep | None:
        """Return the step that a message completes, if any."""
        if index != self._index:
            self.broken += bool(self._parts)
            self._parts, self._index = {}, index
        try:
            message = json.loads(data)
            self._parts.setdefault(topic, []).append(message)
            return self._step() if topic == LAST else None
        except _IMPOSSIBLE:
            self.broken += 1
        finally:
            if topic == LAST:
                self._parts = {}
        return None

    def _step(self) -> RecordedStep:
        parts = {topic: messages[0] for topic, messages in self._parts.items()}
        finger, board = parts["/finger"], parts[LAST]
        image = self._image_of(parts)
        sequence = _sequence_of(parts["/sequence"], self.electrodes)
        remember(self._sequences, sequence.time_ns, sequence)
        activation = _activation_of(parts["/tactile"], self.electrodes)
        time_ns, force_n = int(finger["time_ns"]), _number(finger["force_n"])
        where = {
            "pose": Pose(*(_number(finger[key]) for key in ("x_mm", "y_mm", "angle_rad"))),
            "number": int(finger["number"]),
            "age_ns": round(finger["age_ms"] * 1e6),
            "stale": bool(finger["stale"]),
        }
        given: Input
        tactile: TactileImage
        asked = _asked(parts["/request"]) if image is None or "/request" in parts else (None, 1.0)
        if image is None or not parts.get("/request", {"imaged": True}).get("imaged", False):
            given = tactile = Stimulus(activation, time_ns, force_n, *asked, image=image, **where)
        else:
            tactile = TactileImage(activation, time_ns, force_n, *asked)
            given = Frame(image, time_ns, force_n=force_n, period_us=asked[0], **where)
        row = parts["/sequence"]
        step = Step(
            input=given,
            tactile=tactile,
            sequence=sequence,
            mode=Mode(row["mode"]),
            level=float(row["level"]),
            restarted=bool(row["restarted"]),
            asked_us=int(row["asked_us"]),
            observed=tuple(self._measured(each) for each in self._parts.get("/volts", ())),
        )
        number = None if board["sent"] is None else int(board["sent"])
        took = float(board["latency_us"]), float(board["work_us"])
        clock_ns = int(board.get("clock_ns", -1))
        sent = StepResult(step, number, *took, first_pulse=_begun(board), clock_ns=clock_ns)
        return RecordedStep(self._index, sent, int(board["acknowledged"]), int(board["refused"]))

    def _image_of(self, parts: dict[str, Message]) -> NDArray[np.uint8] | None:
        """Return the image of a step, or None where a stimulus has none."""
        number = parts["/finger"]["number"]
        if "/frame" in parts:
            self._image, self._image_number = _decoded(parts["/frame"]), number
        # Older recordings have an image for all.
        elif "/request" in parts and not parts["/request"].get("image", True):
            return None
        if self._image is None or self._image_number != number:
            raise ValueError("the image of this step is missing")
        return self._image

    def _measured(self, message: Message) -> Measured:
        sequence = self._sequences[message["time_ns"]]
        volts = np.frombuffer(base64.b64decode(message["volts"]), "<f4")
        return sequence, volts.astype(np.float32).reshape(sequence.slots)


def _begun(board: Message) -> FirstPulse | None:
    # Older recordings do not have it.
    if board.get("begun") is None:
        return None
    return FirstPulse(
        int(board["begun"]), float(board["first_pulse_us"]), float(board["waited_us"])
    )


def _sequence_of(message: Message, electrodes: int) -> ScanSequence:
    """Return the sequence in a message of `/sequence`; ValueError or similar if there is none."""
    slots = int(message["slots"])
    current_ua = np.frombuffer(base64.b64decode(message["current_ua"]), "<i2")
    keys = ("width_us", "discharge_us", "site")
    columns = {key: np.array(message[key], np.uint16).reshape(slots) for key in keys}
    shaken = None if message.get("vibration") is None else np.array(message["vibration"], "f4")
    return ScanSequence(
        current_ua=current_ua.astype(np.int16).reshape(slots, electrodes),
        width_us=columns["width_us"],
        discharge_us=columns["discharge_us"],
        site=columns["site"],
        period_us=int(message["period_us"]),
        intensity=float(message["intensity"]),
        time_ns=int(message["time_ns"]),
        vibration=shaken,
        proof=_proof_of(message),
        recharge_ua=_recharge_of(message, electrodes),
        recharge_us=int(message.get("recharge_us", 0)),
    )


def _recharge_of(message: Message, electrodes: int) -> NDArray[np.int16] | None:
    if message.get("recharge_ua") is None:
        return None
    current_ua = np.frombuffer(base64.b64decode(message["recharge_ua"]), "<i2")
    return current_ua.astype(np.int16).reshape(electrodes)


def _proof_of(message: Message) -> SelectivityReport | None:
    if message.get("points") is None:
        return None
    points = np.array(message["points"], np.uint16)
    other, spill = (
        np.array([_number(each) for each in message[key]], np.float32)
        for key in ("worst_other", "worst_spill")
    )
    return SelectivityReport(points, other, spill)


def _asked(message: Message) -> tuple[int | None, float]:
    """Return period, µs, if it has one of its own, and level of a stimulus."""
    period_us, level = message["period_us"], float(message["level"])
    if period_us is not None:
        period_us = int(period_us)
    if not (0 <= (period_us or 0) <= _LONGEST_US and 0 <= level <= 1):
        raise ValueError(f"not a stimulus: {period_us} µs at a level of {level}")
    return period_us, level


def _activation_of(message: Message, electrodes: int) -> NDArray[np.float32]:
    activation = np.zeros((len(Afferent), electrodes), np.float32)
    for each in Afferent:
        row = np.asarray(message[each.name], np.float64)
        if row.shape == (0,):
            continue
        if row.shape != (electrodes,) or not ((row >= 0) & (row <= 1)).all():
            raise ValueError(f"not the activation of {electrodes} electrodes")
        activation[each] = row
    return activation


def _decoded(message: Message) -> NDArray[np.uint8]:
    png = np.frombuffer(base64.b64decode(message["data"]), np.uint8)
    image = cv2.imdecode(png, cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != np.uint8:
        raise ValueError("not an image of grey levels")
    return np.asarray(image, np.uint8)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
