"""Format of recordings: topics with their JSON schemas, the description of a run, its settings."""

import hashlib
import json
import platform
from typing import Annotated, Any, ClassVar

import cv2
import numpy as np
from pydantic import ConfigDict, Field, model_validator

from smarttouch.base.afferent import Afferent
from smarttouch.base.version import __version__
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.scan_sequence import SlotPolicy

FORMAT = "2"  # version of the format, raised when older readers can no longer read it
METADATA = "smarttouch"  # name of the metadata record that describes the run

_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_TEXT = {"type": "string"}
_BASE64 = {"type": "string", "contentEncoding": "base64"}
_IMAGE = {"timestamp": _TIME, "frame_id": _TEXT, "data": _BASE64, "format": _TEXT}
_LOG = {
    "timestamp": _TIME, "level": {"type": "integer"}, "message": _TEXT, "name": _TEXT,
    "file": _TEXT, "line": {"type": "integer"},
}  # fmt: skip
_NUMBERS = (
    "time_ns", "number", "x_mm", "y_mm", "angle_rad", "force_n", "age_ns", "level", "intensity",
    "asked_us", "period_us", "strongest_ma", "slots", "recharge_us", "sent",
    "acknowledged", "refused", "latency_us", "work_us", "clock_ns", "first_pulse_us", "waited_us",
)  # fmt: skip

SCHEMAS: dict[str, tuple[str, dict[str, Any]]] = {
    "/frame": ("foxglove.CompressedImage", _IMAGE),
    "/step": ("smarttouch.Step", {name: {"type": ["number", "null"]} for name in _NUMBERS}),
    "/event": ("foxglove.Log", _LOG),
}
"""Name of each topic's schema, and the properties of its messages that Foxglove can show."""


class RecordedSettings(RunConfig):
    """Settings of a recorded run, with those of its board that its sequences depend on.

    ``carried_pc`` is the net charge of each electrode before a balanced run; empty if none.
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
    def _with_scan(cls, given: dict[str, Any]) -> dict[str, Any]:
        primaries = given.get("sharing", {}).get("primaries", ())
        return {"scan": SlotPolicy(tuple(Afferent[name] for name in primaries))} | given


def recorded_settings(config: RunConfig, profile: Profile) -> dict[str, Any]:
    """Return what a recording keeps of a configuration, ready for JSON."""
    kept = config.model_dump(mode="json", exclude={"scan", "seconds", "intensity", "paced"})
    return kept | {
        "sharing": {"primaries": [each.name for each in config.sharing(profile).afferents]}
    }


def about_run(profile: Profile, settings: dict[str, Any], started_unix_ns: int) -> dict[str, str]:
    """Return the description of a run in its recording, with the software versions and a digest.

    Of the settings, `RecordedSettings` are what sequences depend on; all others are for readers.
    """
    libraries = {"numpy": np.__version__, "opencv": cv2.__version__}
    versions = {
        "smarttouch": __version__,
        "python": platform.python_version(),
        **libraries,
        "platform": platform.platform(),
    }
    about = {
        "format": FORMAT,
        "started_unix_ns": str(started_unix_ns),
        "profile": profile.model_dump_json(),
        "settings": json.dumps(settings, default=str),
        "versions": json.dumps(versions),
    }
    return about | {"digest": digest_of(about)}


def digest_of(about: dict[str, str]) -> str:
    """Return the SHA-256 of a description, without its digest."""
    rest = {key: value for key, value in about.items() if key != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()
