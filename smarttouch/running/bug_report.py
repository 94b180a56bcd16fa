"""Facts for a bug report, from lists of what may be in one: nothing about participants."""

import platform
import re
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

from smarttouch.base.registry import known_names
from smarttouch.base.version import __version__
from smarttouch.running.recording_reader import Recording

_URLS = {"sensor": "sources", "board": "boards", "vibrators": "boards", "force": "forces"}
"""Settings that are URLs, with the group in which the name of each is known."""
_VERSIONS = ("smarttouch", "python", "numpy", "opencv", "scipy", "mcap")
_VERSION = re.compile(r"\d[\w.+-]{0,40}")
_FIRMWARE = re.compile(
    r"SmartTouch board emulator \d+|simulated|memory|kajimoto61"
    r"|(?:eTactileKit )?(?=[a-zA-Z_.+-]*\d)[\w.+-]{1,40}"
)
_PULSE = ("width_us", "discharge_us", "rate_hz", "carrier", "ra_rate_hz", "sai_rate_hz")
_LIMITS = ("total_ma", "pulse_us", "charge_uc", "rate_hz", "duty", "ramp_s", "density_uc_cm2")
"""Limits of a device; those of single electrodes and of the current are of a person, too."""


def bug_report(recording: Path | None = None) -> dict[str, Any]:
    """Return what helps to find a fault; with a recording also what is known of that run.

    What is not in the lists of this module is left out: of a profile all but the device, and of a
    run all names of files, ports and people, all that was typed, and all currents.
    """
    report: dict[str, Any] = {
        "smarttouch": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": dict(_packages()),
        "drivers": list(known_names("smarttouch.boards")),
    }
    if recording is not None:
        report["run"] = _of_run(Recording(recording))
    return report


def _packages() -> list[tuple[str, str]]:
    """Return each package that this one requires, also by an extra, with its version."""
    try:
        wanted = requires("smarttouch") or []
    except PackageNotFoundError:
        return []
    found = []
    for name in sorted({re.split(r"[^\w.-]", each, maxsplit=1)[0] for each in wanted}):
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:
            found.append((name, "missing"))
    return found


def _of_run(recording: Recording) -> dict[str, Any]:
    settings, profile = recording.settings, recording.profile
    kinds = {name: _kind(settings.get(name), group) for name, group in _URLS.items()}
    made_with, firmware = recording.versions, _FIRMWARE.match(str(settings.get("firmware")))
    return {
        "versions": {name: _version(made_with.get(name)) for name in _VERSIONS},
        "whole": recording.whole,
        "damaged_chunks": recording.damaged_chunks,
        "lasted_s": round(recording.duration_s, 3),
        "firmware": firmware[0] if firmware else None,
        "settings": kinds | recording.run.model_dump(mode="json", by_alias=True),
        "device": {
            "array": profile.array.model_dump(mode="json"),
            "output": profile.output.kind,
            "pulse": profile.pulse.model_dump(mode="json", include={*_PULSE}),
            "limits": profile.limits.model_dump(mode="json", include={*_LIMITS}),
        },
    }


def _kind(url: object, group: str) -> str | None:
    """Return the name that a URL begins with if it is one of a group, as no file's name is."""
    name, colon, _ = str(url or "").partition(":")
    known = known_names(f"smarttouch.{group}")
    if colon and (name in known or name == "experiment"):
        return f"{name}:"
    return "other" if url else None


def _version(found: object) -> str | None:
    """Return a version as programs write it; None for any other words."""
    return found if isinstance(found, str) and _VERSION.fullmatch(found) else None
