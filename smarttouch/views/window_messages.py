"""Messages to pages: the run as it begins, and each step as numbers."""

import base64
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Pose, Sheet
from smarttouch.stimulation.scan_sequence import ScanSequence

MOST_PIXELS = 160  # longer side of an image of what a sensor sees; larger ones are made smaller
_MOST_SHEET_PX = 1600
_DIGITS = 4
Message = dict[str, Any]


def array_message(profile: Profile) -> Message:
    """Return the array and limits of a profile, as a page draws them."""
    electrodes, limits = profile.electrodes, profile.limits
    radius_mm = 0.42 * min(*electrodes.cell_mm, electrodes.pitch_mm)
    return {
        "profile": profile.title,
        "place_mm": electrodes.position_mm.round(_DIGITS).tolist(),
        "extent_mm": [round(each, _DIGITS) for each in electrodes.extent_mm],
        "field_mm": [float(profile.optics.field_width_mm), float(profile.optics.field_height_mm)],
        "radius_mm": round(radius_mm, _DIGITS),
        "full_ma": float(profile.full_ma.max()),
        "full_n": float(profile.force.full_n),
        "limits": {
            "current_ma": float(limits.current_ma),
            "charge_uc": float(limits.charge_uc),
            "session_s": float(limits.session_s),
            "session_mc": float(limits.session_mc),
        },
    }


def picture_message(sent: StepResult) -> Message:
    """Return what was seen and delivered in one step."""
    step, given, sequence = sent.step, sent.step.input, sent.step.sequence
    picture = {
        "time_s": given.time_ns / 1e9,
        "number": sent.number,
        "mode": str(step.mode),
        "pose": _pose(given.pose),
        "force_n": _number(given.force_n),
        "age_ms": given.age_ns / 1e6,
        "latency_ms": given.age_ns / 1e6 + sent.latency_us / 1e3,
        "pulse_ms": sent.first_pulse and sent.first_pulse.latency_us / 1e3,
        **sequence_message(sequence),
    }
    if given.image is not None:
        picture["image"] = _image(given.image)
    return picture


def sequence_message(sequence: ScanSequence) -> Message:
    """Return the currents of a sequence; positive is cathodic."""
    peak_ma = float(np.abs(sequence.current_ua.astype(np.int32)).max(initial=0)) / 1000
    return {
        "slots": sequence.slots,
        "points": sequence.points,
        "period_us": sequence.period_us,
        "intensity": float(sequence.intensity),
        "peak_ma": peak_ma,
        "charge_uc": peak_ma * float(sequence.width_us.max(initial=0)) / 1000,
        "current_ua": _base64(sequence.current_ua.astype("<i2")),
        "width_us": sequence.width_us.tolist(),
        "site": sequence.site.tolist(),
    }


def _image(image: NDArray[np.uint8]) -> Message:
    longer = max(image.shape)
    if longer > MOST_PIXELS:
        height, width = (max(1, round(each * MOST_PIXELS / longer)) for each in image.shape)
        image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))
    return {"height": image.shape[0], "width": image.shape[1], "grey": _base64(image)}


def sheet_message(sheet: Sheet) -> Message:
    """Return where a page or a line lies, as poses count."""
    return {
        "number": sheet.number,
        "size_mm": [round(each, _DIGITS) for each in sheet.page.size_mm],
        "corner_mm": [round(each, _DIGITS) for each in sheet.corner_mm],
    }


def sheet_png(sheet: Sheet) -> bytes:
    """Return the picture of a page or a line, not larger than a window shows it."""
    grey = sheet.page.grey
    scale = min(1.0, _MOST_SHEET_PX / max(grey.shape))
    if scale < 1:
        grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    return cv2.imencode(".png", grey)[1].tobytes()


def _pose(pose: Pose) -> list[float]:
    return [round(pose.x_mm, 3), round(pose.y_mm, 3), round(pose.angle_rad, 4)]


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
