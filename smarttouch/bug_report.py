"""Facts for a bug report: versions, boards, settings and last events; nothing of participants."""

import platform
import re
from importlib.metadata import PackageNotFoundError, entry_points, requires, version
from pathlib import Path
from typing import Any

from smarttouch.boards.discovery import serial_ports
from smarttouch.recording.reader import Recording
from smarttouch.registry import known_names
from smarttouch.version import __version__

_GROUPS = ("boards", "sources", "forces")
_LAST = 50
"""Most events that are told, from the end."""
_OF_A_PERSON = ("intensity ",)
"""Beginnings of events that say what a person wished."""
_OF_PEOPLE = "experiment:"
"""Beginning of sources whose events are trials and answers."""


def bug_report(recording: Path | None = None) -> dict[str, Any]:
    """Return what helps to find a fault; with a recording also what is known of that run.

    Of a profile only the device is told, not thresholds or what else was measured on a finger;
    of a run neither subject, note, names of files, intensities nor, of experiments, any event.

    Raises
    ------
    RecordingError
        If there is no such recording.
    """
    told: dict[str, Any] = {
        "smarttouch": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": dict(_packages()),
        "others": {group: _others(group) for group in _GROUPS},
        "drivers": list(known_names("smarttouch.boards")),
        "ports": [each.description for each in serial_ports()],
    }
    if recording is not None:
        told["run"] = _of_run(Recording(recording))
    return told


def _packages() -> list[tuple[str, str]]:
    """Return each package that this one asks for, also by an extra, with its version."""
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
    """Return what other packages bring, with their versions."""
    return sorted(
        f"{each.name}: of {each.dist.name} {each.dist.version}" if each.dist else each.name
        for each in entry_points(group=f"smarttouch.{group}")
    )


def _of_run(recording: Recording) -> dict[str, Any]:
    settings, profile = recording.settings, recording.profile
    kinds = {name: _kind(settings.get(name)) for name in ("sensor", "board", "vibrators", "force")}
    return {
        "versions": recording.versions,
        "whole": recording.whole,
        "damaged_chunks": recording.damaged_chunks,
        "lasted_s": round(recording.duration_s, 3),
        "firmware": settings.get("firmware"),
        "settings": kinds | recording.run.model_dump(mode="json", by_alias=True),
        "device": {
            "array": profile.array.model_dump(mode="json"),
            "output": profile.output.kind,
            "pulse": profile.pulse.model_dump(mode="json"),
            "limits": profile.limits.model_dump(mode="json"),
        },
        "events": _events(recording, str(settings.get("sensor") or "")),
    }


def _kind(url: object) -> str | None:
    """Return a URL without the file, port or words that it names."""
    return f"{str(url).partition(':')[0]}:" if url else None


def _events(recording: Recording, source: str) -> list[str]:
    if source.startswith(_OF_PEOPLE):
        return []
    named = re.compile("|".join(map(re.escape, filter(None, (source.partition(":")[2],)))) or "$^")
    told = [
        f"{at_ns / 1e9:.3f} s  {named.sub('…', words)}"
        for at_ns, words in recording.events()
        if not words.startswith(_OF_A_PERSON)
    ]
    return told[-_LAST:]
