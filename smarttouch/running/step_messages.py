"""Steps of a run as JSON messages and back, lossless in all that sequences depend on."""

import base64
import json
import math
import sys
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.tactile_image import TactileImage
from smarttouch.running.step import FirstPulse, Measured, Step, StepResult
from smarttouch.sources.source_contract import Frame, Input, Pose, Stimulus
from smarttouch.stimulation.scan_sequence import ScanSequence, SelectivityReport

_REMEMBERED = 512  # sequences kept for later measurements of their voltage: a second or more
_INFO = 2  # level of events in foxglove.Log
# Of all that OpenCV offers, this is fastest and smallest on frames with a sensor's noise.
_PNG = (
    cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
)  # fmt: skip
_INVALID = (ValueError, TypeError, LookupError, AttributeError, OverflowError, cv2.error)
"""Exceptions of messages that are valid JSON with invalid content."""
_LONGEST_US = 10_000_000  # longest time between two stimuli: the period of the slowest rate

Message = dict[str, Any]


def image_message(image: NDArray[np.uint8], unix_ns: int) -> Message:
    """Return an image as a foxglove.CompressedImage."""
    _, png = cv2.imencode(".png", image, _PNG)
    data = base64.b64encode(png.tobytes()).decode("ascii")
    return {"timestamp": _timestamp(unix_ns), "frame_id": "sensor", "data": data, "format": "png"}


def event_message(words: str, unix_ns: int) -> Message:
    """Return an event as a foxglove.Log."""
    return {
        "timestamp": _timestamp(unix_ns), "level": _INFO, "message": words, "name": "smarttouch",
        "file": "", "line": 0,
    }  # fmt: skip


def step_message(result: StepResult) -> Message:
    """Return all of a step but its image."""
    step, given, sequence = result.step, result.step.input, result.step.sequence
    pose, pulse, proof = given.pose, result.first_pulse, sequence.proof
    return {
        "time_ns": given.time_ns,
        "number": given.number,
        "x_mm": _finite(pose.x_mm),
        "y_mm": _finite(pose.y_mm),
        "angle_rad": _finite(pose.angle_rad),
        "force_n": _finite(given.force_n),
        "age_ns": given.age_ns,
        "stale": given.stale,
        "stimulus": isinstance(given, Stimulus),
        "image": given.image is not None,
        "given_period_us": given.period_us,
        "given_level": float(step.tactile.level),
        "activation": _packed(step.tactile.activation, "<f4"),
        "mode": step.mode.value,
        "level": float(step.level),
        "restarted": step.restarted,
        "allowed": step.allowed,
        "asked_us": step.asked_us,
        "period_us": sequence.period_us,
        "intensity": float(sequence.intensity),
        "sequence_ns": sequence.time_ns,
        "strongest_ma": int(np.abs(sequence.current_ua.astype(np.int32)).max(initial=0)) / 1000,
        "slots": sequence.slots,
        "current_ua": _packed(sequence.current_ua, "<i2"),
        "site": _packed(sequence.site, "<u2"),
        "width_us": _packed(sequence.width_us, "<u2"),
        "discharge_us": _packed(sequence.discharge_us, "<u2"),
        "vibration": _packed(sequence.vibration, "<f4"),
        "recharge_us": int(sequence.recharge_us),
        "recharge_ua": _packed(sequence.recharge_ua, "<i2"),
        "points": _packed(None if proof is None else proof.points, "<u2"),
        "worst_other": _packed(None if proof is None else proof.off_target, "<f4"),
        "worst_spill": _packed(None if proof is None else proof.spill, "<f4"),
        "volts": [[of.time_ns, _packed(measured, "<f4")] for of, measured in step.observed],
        "sent": result.number,
        "acknowledged": result.acknowledged,
        "refused": result.refused,
        "latency_us": result.latency_us,
        "work_us": result.work_us,
        "clock_ns": result.clock_ns,
        "begun": pulse and pulse.number,
        "first_pulse_us": pulse and pulse.latency_us,
        "waited_us": pulse and pulse.waited_us,
    }


@dataclass(frozen=True, eq=False)
class RecordedStep:
    """One recorded step of a run, by its number from 0; one missing in a file is not yielded."""

    index: int
    sent: StepResult
    message: Message

    @property
    def step(self) -> Step:
        return self.sent.step


@dataclass
class StepDecoder:
    """Decodes the messages of a run in the order of the file; invalid ones count as ``broken``."""

    electrodes: int
    broken: int = 0
    _image: NDArray[np.uint8] | None = None
    _image_index: int = -1
    _image_number: int = -1
    _sequences: OrderedDict[int, ScanSequence] = field(default_factory=OrderedDict)

    def take(self, topic: str, index: int, data: bytes) -> RecordedStep | None:
        """Return the step in a message; None for others, and for invalid ones."""
        try:
            if topic == "/frame":
                self._image, self._image_index = _image_of(json.loads(data)), index
            elif topic == "/step":
                message = json.loads(data)
                return RecordedStep(index, self._step(index, message), message)
        except _INVALID:
            self.broken += 1
        return None

    def _step(self, index: int, message: Message) -> StepResult:
        if self._image_index == index:
            self._image_number = message["number"]
        image = self._image if message["image"] else None
        if message["image"] and self._image_number != message["number"]:
            raise ValueError("the image of this step is missing")
        sequence = self._sequence(message)
        self._sequences[sequence.time_ns] = sequence
        if len(self._sequences) > _REMEMBERED:
            self._sequences.popitem(last=False)
        given, tactile = self._input(message, image)
        step = Step(
            input=given,
            tactile=tactile,
            sequence=sequence,
            mode=Mode(message["mode"]),
            level=float(message["level"]),
            restarted=bool(message["restarted"]),
            asked_us=int(message["asked_us"]),
            observed=tuple(self._measured(*each) for each in message["volts"]),
            allowed=None if (allowed := message.get("allowed")) is None else float(allowed),
        )
        pulse = None
        if message["begun"] is not None:
            times_us = float(message["first_pulse_us"]), float(message["waited_us"])
            pulse = FirstPulse(int(message["begun"]), *times_us)
        return StepResult(
            step,
            None if message["sent"] is None else int(message["sent"]),
            float(message["latency_us"]),
            float(message["work_us"]),
            int(message["acknowledged"]),
            int(message["refused"]),
            pulse,
            int(message["clock_ns"]),
        )

    def _input(
        self, message: Message, image: NDArray[np.uint8] | None
    ) -> tuple[Input, TactileImage]:
        activation = _unpacked(message["activation"], "<f4", len(Afferent), self.electrodes)
        time_ns, force_n = int(message["time_ns"]), _number(message["force_n"])
        period_us, level = message["given_period_us"], float(message["given_level"])
        possible = 0 <= (period_us or 0) <= _LONGEST_US and 0 <= level <= 1
        if not possible or not ((activation >= 0) & (activation <= 1)).all():
            raise ValueError("not a stimulus")
        common: dict[str, Any] = {
            "pose": Pose(*(_number(message[key]) for key in ("x_mm", "y_mm", "angle_rad"))),
            "number": int(message["number"]),
            "age_ns": int(message["age_ns"]),
            "stale": bool(message["stale"]),
        }
        if message["stimulus"]:
            stimulus = Stimulus(
                activation, time_ns, force_n, period_us, level, image=image, **common
            )
            return stimulus, stimulus
        if image is None:
            raise ValueError("a frame without an image")
        frame = Frame(image, time_ns, force_n=force_n, period_us=period_us, **common)
        return frame, TactileImage(activation, time_ns, force_n, period_us, level)

    def _sequence(self, message: Message) -> ScanSequence:
        slots = int(message["slots"])
        proof = None
        if message["points"] is not None:
            ratios = (
                _unpacked(message[key], "<f4", slots) for key in ("worst_other", "worst_spill")
            )
            proof = SelectivityReport(_unpacked(message["points"], "<u2", slots), *ratios)
        return ScanSequence(
            current_ua=_unpacked(message["current_ua"], "<i2", slots, self.electrodes),
            width_us=_unpacked(message["width_us"], "<u2", slots),
            discharge_us=_unpacked(message["discharge_us"], "<u2", slots),
            site=_unpacked(message["site"], "<u2", slots),
            period_us=int(message["period_us"]),
            intensity=float(message["intensity"]),
            time_ns=int(message["sequence_ns"]),
            vibration=_unpacked(message["vibration"], "<f4", self.electrodes),
            proof=proof,
            recharge_ua=_unpacked(message["recharge_ua"], "<i2", self.electrodes),
            recharge_us=int(message["recharge_us"]),
        )

    def _measured(self, time_ns: int, volts: str) -> Measured:
        sequence = self._sequences[time_ns]
        return sequence, _unpacked(volts, "<f4", sequence.slots)


def _image_of(message: Message) -> NDArray[np.uint8]:
    png = np.frombuffer(base64.b64decode(message["data"]), np.uint8)
    image = cv2.imdecode(png, cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != np.uint8:
        raise ValueError("not an image of grey levels")
    return np.asarray(image, np.uint8)


def _timestamp(unix_ns: int) -> Message:
    seconds, nanoseconds = divmod(unix_ns, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}


def _packed(values: NDArray[Any] | None, kind: DTypeLike) -> str | None:
    if values is None:
        return None
    return base64.b64encode(np.asarray(values).astype(kind).tobytes()).decode("ascii")


def _unpacked(text: str | None, kind: DTypeLike, *shape: int) -> Any:
    """Return an array in the machine's byte order, None for null; ValueError for another size."""
    if text is None:
        return None
    values = np.frombuffer(base64.b64decode(text, validate=True), kind)
    return values.astype(values.dtype.newbyteorder("=")).reshape(shape)


def _finite(value: float) -> float | None:
    """Return a number for JSON: null for NaN, the largest for an infinite one."""
    value = float(value)
    if math.isnan(value):
        return None
    return max(-sys.float_info.max, min(value, sys.float_info.max))


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
