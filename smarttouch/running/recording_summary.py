"""Summary of a recording as names and values."""

from collections import Counter
from pathlib import Path

from smarttouch.running.recording import Recording


def describe(path: Path) -> list[tuple[str, str]]:
    """Return the names and values of a recording's summary, for display."""
    recording = Recording(path)
    settings, steps = recording.settings, [step for _, step in recording.contents("/step")]
    modes = Counter(step["mode"] for step in steps)
    last = steps[-1] if steps else {"acknowledged": 0, "refused": 0}
    slots = sum(step["slots"] for step in steps)
    lost = sum(step["sent"] is None for step in steps)
    strongest_ma = max((step["strongest_ma"] for step in steps), default=0.0)
    rows = [
        ("began", f"{recording.started:%Y-%m-%d %H:%M:%S} UTC"),
        ("lasted", f"{recording.seconds:.1f} s"),
        ("subject", str(settings.get("subject") or "not given")),
        ("note", str(settings.get("note") or "none")),
        ("profile", f"{recording.profile.name}, {recording.profile.title}"),
        ("source", str(settings.get("sensor"))),
        ("force", str(settings.get("force") or "the source's or the board's")),
        ("board", str(settings.get("board"))),
        ("mode", ", ".join(f"{mode} {count:,}" for mode, count in modes.items()) or "none"),
        (
            "sequences",
            f"{len(steps):,}, {slots:,} slots; {last['acknowledged']:,} acknowledged, "
            f"{last['refused']:,} refused, {lost:,} lost with the board",
        ),
        ("strongest", f"{strongest_ma:.2f} mA through one electrode"),
        ("versions", ", ".join(f"{name} {value}" for name, value in recording.versions.items())),
        ("file", f"{path.stat().st_size / 1e6:.2f} MB"),
        *((f"{at_ns / 1e9:10.3f} s", words) for at_ns, words in recording.events),
    ]
    # Damage shows only once everything has been read.
    return [("state", _state(recording)), *rows]


def _state(recording: Recording) -> str:
    if recording.whole:
        return "whole"
    if recording.damaged_chunks:
        return f"damaged: {recording.damaged_chunks} chunks cannot be read"
    return "cut: the program that wrote it did not end in order"
