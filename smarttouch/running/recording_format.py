"""Format of recordings: description of a run, and conversion of steps to JSON messages and back.

The format stores, without any loss, all data that sequences depend on.
"""

import base64
import hashlib
import json
import math
import platform
import sys
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray
from pydantic import ConfigDict, Field, model_validator

from smarttouch.base import __version__
from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.tactile_image import TactileImage
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.step_records import FirstPulse, Step, StepResult
from smarttouch.sources.source_contract import Frame, Input, Pose, Stimulus
from smarttouch.stimulation.scan_sequence import (
    ScanSequence,
    ScanTiming,
    SelectivityReport,
    SlotPolicy,
)
from smarttouch.stimulation.sequence_limits import LONGEST_PERIOD_US

FORMAT = "2"  # version of the format; increase it if older programs cannot read new files
METADATA = "smarttouch"  # name of the metadata record that describes the run
Message = dict[str, Any]

# Fields of a step's message, with the type of each value and the packed dtype of each array.
_INPUT = {"time_ns": int, "number": int, "age_ns": int, "stale": bool}
_POSE = ("x_mm", "y_mm", "angle_rad")
_SEQUENCE = {"period_us": int, "intensity": float, "recharge_us": int}
_SLOTS = {"site": "<u2", "width_us": "<u2", "discharge_us": "<u2"}
_ELECTRODES = {"vibration": "<f4", "recharge_ua": "<i2"}
_PROOF = {"points": ("points", "<u2"), "worst_other": ("off_target", "<f4"),
          "worst_spill": ("spill", "<f4")}  # fmt: skip
_RESULT = {"latency_us": float, "work_us": float, "acknowledged": int, "refused": int,
           "clock_ns": int}  # fmt: skip

_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_TEXT = {"type": "string"}
_BASE64 = {"type": "string", "contentEncoding": "base64"}
_IMAGE = {"timestamp": _TIME, "frame_id": _TEXT, "data": _BASE64, "format": _TEXT}
_LOG = {
    "timestamp": _TIME, "level": {"type": "integer"}, "message": _TEXT, "name": _TEXT,
    "file": _TEXT, "line": {"type": "integer"},
}  # fmt: skip
_NUMBERS = (
    "time_ns", "number", "age_ns", "force_n", *_POSE, *_SEQUENCE, *_RESULT, "level", "asked_us",
    "strongest_ma", "slots", "sent", "first_pulse_us", "waited_us",
)  # fmt: skip

SCHEMAS: dict[str, tuple[str, dict[str, Any]]] = {
    "/frame": ("foxglove.CompressedImage", _IMAGE),
    "/step": ("smarttouch.Step", {name: {"type": ["number", "null"]} for name in _NUMBERS}),
    "/event": ("foxglove.Log", _LOG),
}
"""Schema name of each topic, and the properties of the topic's messages that Foxglove can show."""

# For frames with sensor noise these options are the fastest and give the smallest files.
_PNG = (
    cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
)  # fmt: skip
_INFO = 2  # level of events in foxglove.Log
_REMEMBERED = 512  # number of latest sequences to keep, because voltages refer to them
_LONGEST_US = 10_000_000  # longest time between two stimuli: the period of the slowest rate
_INVALID = (ValueError, TypeError, LookupError, AttributeError, OverflowError, cv2.error)
"""Exceptions raised by valid JSON with invalid content."""


class RecordedConfig(RunConfig):
    """Configuration of a recorded run, with everything else that its sequences depend on.

    ``carried_pc`` is the net charge of each electrode at the start, pC; empty if there is none.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="ignore")

    timing: ScanTiming
    compliance_v: float | None
    recharge: bool = False
    carried_pc: tuple[Annotated[int, Field(ge=-(2**53), le=2**53)], ...] = ()
    vibrated: bool = False
    in_sums: bool = False

    @model_validator(mode="before")
    @classmethod
    def _with_scan(cls, settings: dict[str, Any]) -> dict[str, Any]:
        primaries = settings.get("sharing", {}).get("primaries", ())
        return {"scan": SlotPolicy(tuple(Afferent[name] for name in primaries))} | settings


def recorded_settings(config: RunConfig, profile: Profile) -> dict[str, Any]:
    """Convert a configuration to the settings that recordings store, for JSON."""
    settings = config.model_dump(mode="json", exclude={"scan", "seconds", "intensity", "paced"})
    shared = [afferent.name for afferent in config.sharing(profile).afferents]
    return settings | {"sharing": {"primaries": shared}}


def about_run(profile: Profile, settings: dict[str, Any], started_unix_ns: int) -> dict[str, str]:
    """Return the description of a run, with software versions and a digest.

    Sequences depend only on the settings in `RecordedConfig`. Other settings are for information.
    """
    versions = {
        "smarttouch": __version__, "python": platform.python_version(), "numpy": np.__version__,
        "opencv": cv2.__version__, "platform": platform.platform(),
    }  # fmt: skip
    about = {
        "format": FORMAT,
        "started_unix_ns": str(started_unix_ns),
        "profile": profile.model_dump_json(),
        "settings": json.dumps(settings, default=str),
        "versions": json.dumps(versions),
    }
    return about | {"digest": digest_of(about)}


def digest_of(about: dict[str, str]) -> str:
    """Return the SHA-256 of the description of a run, computed without the entry ``digest``."""
    rest = {key: value for key, value in about.items() if key != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


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
    """Return a step as a message, without its image."""
    step, step_input, sequence = result.step, result.step.input, result.step.sequence
    pulse, proof = result.first_pulse, sequence.proof
    return {
        **{name: getattr(step_input, name) for name in _INPUT},
        **{name: _finite(getattr(step_input.pose, name)) for name in _POSE},
        "force_n": _finite(step_input.force_n),
        "stimulus": isinstance(step_input, Stimulus),
        "image": step_input.image is not None,
        "given_period_us": step_input.period_us,
        "given_level": float(step.tactile.level),
        "activation": _packed(step.tactile.activation, "<f4"),
        "mode": step.mode.value,
        "level": float(step.level),
        "restarted": step.restarted,
        "allowed": step.allowed,
        "asked_us": step.asked_us,
        "sequence_ns": sequence.time_ns,
        **{name: kind(getattr(sequence, name)) for name, kind in _SEQUENCE.items()},
        "strongest_ma": int(np.abs(sequence.current_ua.astype(np.int32)).max(initial=0)) / 1000,
        "slots": sequence.slots,
        "current_ua": _packed(sequence.current_ua, "<i2"),
        **{name: _packed(getattr(sequence, name), kind) for name, kind in _SLOTS.items()},
        **{name: _packed(getattr(sequence, name), kind) for name, kind in _ELECTRODES.items()},
        **{name: _packed(getattr(proof, of, None), kind) for name, (of, kind) in _PROOF.items()},
        "volts": [[of.time_ns, _packed(measured, "<f4")] for of, measured in step.observed],
        "sent": result.number,
        **{name: getattr(result, name) for name in _RESULT},
        "begun": pulse and pulse.number,
        "first_pulse_us": pulse and pulse.latency_us,
        "waited_us": pulse and pulse.waited_us,
    }


@dataclass(frozen=True, eq=False)
class RecordedStep:
    """Recorded step of a run. ``index`` counts all steps from 0, including missing steps."""

    index: int
    sent: StepResult
    message: Message

    @property
    def step(self) -> Step:
        return self.sent.step


@dataclass
class StepDecoder:
    """Decoder of a run's messages, in the order of the file; ``broken`` counts invalid messages."""

    electrodes: int
    broken: int = 0
    _image: NDArray[np.uint8] | None = None
    _image_index: int = -1
    _image_number: int = -1
    _sequences: OrderedDict[int, ScanSequence] = field(default_factory=OrderedDict)

    def take(self, topic: str, index: int, data: bytes, at_ns: int) -> RecordedStep | None:
        """Return the step in a message; None for other topics and for invalid messages."""
        try:
            if topic == "/frame":
                self._image, self._image_index = _image_of(json.loads(data)), index
            elif topic == "/step":
                message, longest_us = json.loads(data), LONGEST_PERIOD_US
                # With impossible times, a replay could wait forever.
                if message["time_ns"] != at_ns or not 0 < message["period_us"] <= longest_us:
                    raise ValueError("not a time of this run")
                return RecordedStep(index, self._step(index, message), message)
        except _INVALID:
            self.broken += 1
        return None

    def _step(self, index: int, message: Message) -> StepResult:
        if self._image_index == index:
            self._image_number = message["number"]
        if message["image"] and self._image_number != message["number"]:
            raise ValueError("the image of this step is missing")
        sequence = self._sequence(message)
        self._sequences[sequence.time_ns] = sequence
        if len(self._sequences) > _REMEMBERED:
            self._sequences.popitem(last=False)
        step_input, tactile = self._input(message)
        observed = [(self._sequences[time_ns], volts) for time_ns, volts in message["volts"]]
        step = Step(
            input=step_input,
            tactile=tactile,
            sequence=sequence,
            mode=Mode(message["mode"]),
            level=float(message["level"]),
            restarted=bool(message["restarted"]),
            asked_us=int(message["asked_us"]),
            observed=tuple((of, _unpacked(volts, "<f4", of.slots)) for of, volts in observed),
            allowed=None if (allowed := message.get("allowed")) is None else float(allowed),
        )
        pulse = None
        if message["begun"] is not None:
            times_us = float(message["first_pulse_us"]), float(message["waited_us"])
            pulse = FirstPulse(int(message["begun"]), *times_us)
        number = None if message["sent"] is None else int(message["sent"])
        return StepResult(step, number, first_pulse=pulse, **_read(message, _RESULT))

    def _input(self, message: Message) -> tuple[Input, TactileImage]:
        image = self._image if message["image"] else None
        activation = _unpacked(message["activation"], "<f4", len(Afferent), self.electrodes)
        period_us, level = message["given_period_us"], float(message["given_level"])
        possible = 0 <= (period_us or 0) <= _LONGEST_US and 0 <= level <= 1
        if not possible or not ((activation >= 0) & (activation <= 1)).all():
            raise ValueError("not a stimulus")
        common: dict[str, Any] = _read(message, _INPUT) | {
            "pose": Pose(*(_number(message[name]) for name in _POSE)),
            "force_n": _number(message["force_n"]),
            "period_us": period_us,
            "image": image,
        }
        if message["stimulus"]:
            stimulus = Stimulus(activation, level=level, **common)
            return stimulus, stimulus
        if image is None:
            raise ValueError("a frame without an image")
        frame = Frame(**common)
        return frame, TactileImage(activation, frame.time_ns, frame.force_n, period_us, level)

    def _sequence(self, message: Message) -> ScanSequence:
        slots, proof = int(message["slots"]), None
        if message["points"] is not None:
            proof = SelectivityReport(
                **{of: _unpacked(message[name], kind, slots) for name, (of, kind) in _PROOF.items()}
            )
        return ScanSequence(
            current_ua=_unpacked(message["current_ua"], "<i2", slots, self.electrodes),
            time_ns=int(message["sequence_ns"]),
            proof=proof,
            **{name: _unpacked(message[name], kind, slots) for name, kind in _SLOTS.items()},
            **{
                name: _unpacked(message[name], kind, self.electrodes)
                for name, kind in _ELECTRODES.items()
            },
            **_read(message, _SEQUENCE),
        )


def _read(message: Message, kinds: dict[str, Any]) -> dict[str, Any]:
    return {name: kind(message[name]) for name, kind in kinds.items()}


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
    """Return an array in native byte order, or None for null. A wrong size raises ValueError."""
    if text is None:
        return None
    values = np.frombuffer(base64.b64decode(text, validate=True), kind)
    return values.astype(values.dtype.newbyteorder("=")).reshape(shape)


def _finite(value: float) -> float | None:
    """Return a number for JSON: None for NaN, the largest float for infinity."""
    value = float(value)
    if math.isnan(value):
        return None
    return max(-sys.float_info.max, min(value, sys.float_info.max))


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
