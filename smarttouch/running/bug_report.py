"""Facts for a bug report, from lists of what may be in one: nothing about participants."""

import platform
import re
from importlib.metadata import PackageNotFoundError, entry_points, requires, version
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from smarttouch.base.afferent import Mode
from smarttouch.base.events import (
    FingerLifted,
    InputLost,
    InputRestored,
    ModeChanged,
    Paused,
    Resumed,
)
from smarttouch.base.registry import known_names
from smarttouch.base.version import __version__
from smarttouch.running.recording_reader import Recording

_GROUPS = ("boards", "sources", "forces")
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
_LAST = 50
_EVENTS = frozenset(
    str(each)
    for each in (
        Paused(0), Resumed(0), InputLost(0, True), InputLost(0, False), InputRestored(0),
        FingerLifted(0), *(ModeChanged(0, mode) for mode in Mode),
    )
)  # fmt: skip
"""Events in a report, by their words. All others have words of files, boards and people."""
_OF_PEOPLE = "experiment:"
"""Beginning of sources whose events are trials and answers."""


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
        "others": {group: _others(group) for group in _GROUPS},
        "drivers": list(known_names("smarttouch.boards")),
        "usb_ports": _usb_ports(),
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


def _others(group: str) -> list[str]:
    """Return the plug-ins of other packages, with their versions."""
    return sorted(
        f"{each.name}: of {each.dist.name} {each.dist.version}" if each.dist else each.name
        for each in entry_points(group=f"smarttouch.{group}")
    )


def _usb_ports() -> list[str]:
    """Return vendor and product of each serial port on USB; descriptions may name their owner."""
    return sorted(
        f"{each.vid:04x}:{each.pid:04x}" for each in list_ports.comports() if each.vid is not None
    )


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
        "events": _events(recording, kinds["sensor"]),
    }


def _kind(url: object, group: str) -> str | None:
    """Return the name that a URL begins with if it is one of a group, as no file's name is."""
    name, colon, _ = str(url or "").partition(":")
    known = known_names(f"smarttouch.{group}")
    if colon and (name in known or f"{name}:" == _OF_PEOPLE):
        return f"{name}:"
    return "other" if url else None


def _version(found: object) -> str | None:
    """Return a version as programs write it; None for any other words."""
    return found if isinstance(found, str) and _VERSION.fullmatch(found) else None


def _events(recording: Recording, source: str | None) -> list[str]:
    if source == _OF_PEOPLE:
        return []
    found = [f"{at_ns / 1e9:.3f} s  {words}" for at_ns, words in recording.events()
             if words in _EVENTS]  # fmt: skip
    return found[-_LAST:]
