"""Summary of a recording as names and values."""

import json
from collections import Counter
from pathlib import Path

from smarttouch.running.recording_format import LAST
from smarttouch.running.recording_reader import Recording


def describe(path: Path) -> list[tuple[str, str]]:
    """Return the names and values of a recording's summary, for display."""
    recording = Recording(path)
    settings, versions = recording.settings, recording.versions
    rows = [
        ("began", f"{recording.started:%Y-%m-%d %H:%M:%S} UTC"),
        ("lasted", f"{recording.duration_s:.1f} s"),
        ("subject", str(settings.get("subject") or "not given")),
        ("note", str(settings.get("note") or "none")),
        ("profile", f"{recording.profile.name}, {recording.profile.title}"),
        ("source", str(settings.get("sensor"))),
        ("force", str(settings.get("force") or "the source's or the board's")),
        ("board", str(settings.get("board"))),
        *_delivered(recording),
        ("versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        ("file", f"{path.stat().st_size / 1e6:.2f} MB"),
        *((f"{at_ns / 1e9:10.3f} s", words) for at_ns, words in recording.events()),
    ]
    # Damage shows only once everything has been read.
    return [("state", _state(recording)), *rows]


def _delivered(recording: Recording) -> list[tuple[str, str]]:
    modes: Counter[str] = Counter()
    slots = lost = strongest_ma = 0
    last = {"acknowledged": 0, "refused": 0}
    for topic, message in recording.messages():
        if topic == "/sequence":
            sequence = json.loads(message.data)
            modes[sequence["mode"]] += 1
            slots += sequence["slots"]
            lost += sequence["number"] is None
            strongest_ma = max(strongest_ma, sequence["strongest_ma"])
        elif topic == LAST:
            last = json.loads(message.data)
    return [
        ("mode", ", ".join(f"{mode} {count:,}" for mode, count in modes.items()) or "none"),
        (
            "sequences",
            f"{modes.total():,}, {slots:,} slots; {last['acknowledged']:,} acknowledged, "
            f"{last['refused']:,} refused, {lost:,} lost with the board",
        ),
        ("strongest", f"{strongest_ma:.2f} mA through one electrode"),
    ]


def _state(recording: Recording) -> str:
    if recording.whole:
        return "whole"
    if recording.damaged_chunks:
        return f"damaged: {recording.damaged_chunks} chunks cannot be read"
    return "cut: the program that wrote it did not end in order"
