"""Encoder of the steps of a run into messages, lossless in all that sequences depend on."""

import base64
import math
import sys
from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.array_picture import ElectrodePicture
from smarttouch.base.electrodes import ElectrodeArray
from smarttouch.physiology.response import in_color
from smarttouch.running.recording_format import INFO, LAST
from smarttouch.running.step import FirstPulse, Step, StepResult
from smarttouch.sources.source_contract import Input, Stimulus
from smarttouch.stimulation.scan_sequence import SelectivityReport

REMEMBERED = 512  # sequences kept for later measurements: a second or more
# Of all that OpenCV offers, this is fastest and smallest on frames with a sensor's noise.
_PNG = (
    cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
)  # fmt: skip
_DIGITS = 4
_PX_PER_CELL = 8

Message = dict[str, Any]


class StepEncoder:
    """Encodes steps as messages, one step after another.

    Times are those of a run that began at ``started_unix_ns``. With electrodes, tactile images are
    drawn as well.
    """

    def __init__(self, started_unix_ns: int, electrodes: ElectrodeArray | None = None) -> None:
        self._started_unix_ns = started_unix_ns
        self._array = None if electrodes is None else tactile_picture(electrodes)
        self._drawn: NDArray[np.float32] | None = None
        self._before: tuple[NDArray[np.uint8], int] | None = None
        self._numbers: OrderedDict[int, int | None] = OrderedDict()

    def messages(self, result: StepResult) -> Iterator[tuple[str, Message]]:
        """Yield topics and messages of a step; its image only if it is a new one."""
        step, given = result.step, result.step.input
        if given.image is not None and self._is_new(given.image, given.number):
            yield "/frame", self._image(given.image, given.time_ns, "sensor")
        yield "/finger", _finger(given)
        yield "/tactile", _tactile(step)
        activation = step.driven
        same = self._drawn is not None and np.array_equal(activation, self._drawn)
        if self._array is not None and not same:
            self._drawn = activation
            picture = cv2.cvtColor(self._array.raster(class_colors(activation)), cv2.COLOR_RGB2BGR)
            yield (
                "/tactile_image",
                self._image(np.asarray(picture, np.uint8), given.time_ns, "finger"),
            )
        if isinstance(given, Stimulus) or given.period_us is not None:
            asked = {"period_us": given.period_us, "level": float(step.tactile.level)}
            own = isinstance(given, Stimulus)
            yield "/request", {**asked, "image": given.image is not None, "imaged": not own}
        yield "/sequence", _sequence(result)
        remember(self._numbers, step.sequence.time_ns, result.number)
        for sequence, volts in step.observed:
            if sequence.time_ns not in self._numbers:
                continue  # of before the recording
            known = np.asarray(volts, np.float64)[np.isfinite(volts)]
            yield (
                "/volts",
                {
                    "time_ns": sequence.time_ns,
                    "number": self._numbers.get(sequence.time_ns),
                    "highest_v": float(known.max()) if len(known) else None,
                    "volts": _base64(np.asarray(volts, "<f4").tobytes()),
                },
            )
        yield (
            LAST,
            {
                "sent": result.number,
                "acknowledged": result.acknowledged,
                "refused": result.refused,
                "latency_us": result.latency_us,
                "work_us": result.work_us,
                "clock_ns": result.clock_ns,
                **_begun(result.first_pulse),
            },
        )

    def event(self, time_ns: int, words: str) -> Message:
        """Return the message of an event."""
        return {
            "timestamp": self._timestamp(time_ns),
            "level": INFO,
            "message": words,
            "name": "smarttouch",
            "file": "",
            "line": 0,
        }

    def _is_new(self, image: NDArray[np.uint8], number: int) -> bool:
        """Return whether an image differs from the one before, whatever its source says."""
        before, self._before = self._before, (image, number)
        return (
            before is None
            or number != before[1]
            or not (image is before[0] or np.array_equal(image, before[0]))
        )

    def _image(self, image: NDArray[np.uint8], time_ns: int, frame_id: str) -> Message:
        _, png = cv2.imencode(".png", image, _PNG)
        return {
            "timestamp": self._timestamp(time_ns),
            "frame_id": frame_id,
            "data": _base64(png.tobytes()),
            "format": "png",
        }

    def _timestamp(self, time_ns: int) -> Message:
        seconds, nanoseconds = divmod(self._started_unix_ns + time_ns, 10**9)
        return {"sec": seconds, "nsec": nanoseconds}


def tactile_picture(electrodes: ElectrodeArray) -> ElectrodePicture:
    """Return the picture in which tactile images are drawn: small, and quick to compress."""
    return ElectrodePicture(electrodes, _PX_PER_CELL / min(electrodes.cell_mm), plain=True)


def class_colors(activation: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return an activation, (3, E), as colors, (E, 3): each class is an ink of its color."""
    return np.asarray(np.rint(255 * in_color(activation, 1.0)), np.uint8)


def remember(kept: OrderedDict[int, Any], key: int, value: Any) -> None:
    """Store a value of a sequence, and drop those too old for a measurement."""
    kept[key] = value
    if len(kept) > REMEMBERED:
        kept.popitem(last=False)


def _finger(given: Input) -> Message:
    pose = given.pose
    return {
        "time_ns": given.time_ns,
        "x_mm": _finite(pose.x_mm),
        "y_mm": _finite(pose.y_mm),
        "angle_rad": _finite(pose.angle_rad),
        "force_n": _finite(given.force_n),
        "number": given.number,
        "age_ms": given.age_ns / 1e6,
        "stale": given.stale,
    }


def _tactile(step: Step) -> Message:
    rounded = step.tactile.activation.astype(np.float64)
    imaged = not isinstance(step.input, Stimulus)
    if imaged:
        rounded = np.round(rounded, _DIGITS)
    # A stimulus cannot be computed again: it is kept to the bit, and as short as it is.
    driven = step.mode.afferents if imaged else ()
    return {
        each.name: rounded[each].tolist() if each in driven or rounded[each].any() else []
        for each in Afferent
    }


def _sequence(result: StepResult) -> Message:
    step, sequence = result.step, result.step.sequence
    return {
        "time_ns": sequence.time_ns,
        "frame": step.input.number,
        "number": result.number,
        "mode": step.mode.value,
        "level": float(step.level),
        "restarted": step.restarted,
        "asked_us": step.asked_us,
        "period_us": sequence.period_us,
        "intensity": float(sequence.intensity),
        "strongest_ma": int(np.abs(sequence.current_ua.astype(np.int32)).max(initial=0)) / 1000,
        "slots": sequence.slots,
        "electrodes": sequence.electrodes,
        "site": sequence.site.tolist(),
        "width_us": sequence.width_us.tolist(),
        "discharge_us": sequence.discharge_us.tolist(),
        "current_ua": _base64(sequence.current_ua.astype("<i2").tobytes()),
        "vibration": None if sequence.vibration is None else sequence.vibration.tolist(),
        **_proof(sequence.proof),
        "recharge_us": int(sequence.recharge_us),
        "recharge_ua": None
        if sequence.recharge_ua is None
        else _base64(sequence.recharge_ua.astype("<i2").tobytes()),
    }


def _begun(pulse: FirstPulse | None) -> Message:
    if pulse is None:
        return dict.fromkeys(("begun", "first_pulse_us", "waited_us"))
    return {
        "begun": pulse.number, "first_pulse_us": pulse.latency_us, "waited_us": pulse.waited_us,
    }  # fmt: skip


def _proof(proof: SelectivityReport | None) -> Message:
    if proof is None:
        return dict.fromkeys(("points", "worst_other", "worst_spill"))
    largest = float(np.finfo(np.float32).max)
    return {
        "points": proof.points.tolist(),
        **{
            key: [None if math.isnan(each) else min(each, largest) for each in values.tolist()]
            for key, values in (
                ("worst_other", proof.off_target), ("worst_spill", proof.spill),
            )
        },
    }  # fmt: skip


def _finite(value: float) -> float | None:
    """Return a number for JSON: null for none, the largest for an infinite one."""
    value = float(value)
    if math.isnan(value):
        return None
    return max(-sys.float_info.max, min(value, sys.float_info.max))


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
