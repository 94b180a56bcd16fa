"""Summary of a recording: start, duration, size, and delivered pulses."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from smarttouch.recording.chunks import parse_message
from smarttouch.recording.reader import Recording
from smarttouch.recording.schemas import LAST


@dataclass
class Account:
    """Summary of a recording.

    By topic: messages and their bytes before compression; sequences in each mode; the strongest
    current of all electrodes and slots, mA; sequences lost with the board.
    """

    messages: Counter[str] = field(default_factory=Counter)
    size: Counter[str] = field(default_factory=Counter)
    slots: int = 0
    lost: int = 0
    strongest_ma: float = 0.0
    modes: Counter[str] = field(default_factory=Counter)
    acknowledged: int = 0
    refused: int = 0

    def _sequence(self, data: bytes) -> None:
        fields = parse_message(data)
        self.slots += _count(fields["slots"])
        self.lost += fields["number"] is None
        self.modes[str(fields["mode"])] += 1
        self.strongest_ma = max(self.strongest_ma, float(fields["strongest_ma"]))

    def _board(self, data: bytes) -> None:
        fields = parse_message(data)
        self.acknowledged = _count(fields["acknowledged"])
        self.refused = _count(fields["refused"])

    def add(self, topic: str, data: bytes) -> None:
        """Add one message; an invalid one counts only by its size."""
        self.messages[topic] += 1
        self.size[topic] += len(data)
        try:
            if topic == "/sequence":
                self._sequence(data)
            elif topic == LAST:
                self._board(data)
        except (ValueError, TypeError, KeyError, OverflowError):
            pass


def _count(value: float) -> int:
    """Return a whole number; ValueError if it is impossible as a count."""
    if not 0 <= value < 2**53:
        raise ValueError(f"{value!r} is no count")
    return int(value)


def account_of(recording: Recording) -> Account:
    """Return the summary of a recording."""
    account = Account()
    for topic, message in recording.messages():
        account.add(topic, message.data)
    return account


def describe(path: Path) -> list[tuple[str, str]]:
    """Return the summary as names and values, for display."""
    recording = Recording(path)
    account = account_of(recording)
    settings, versions = recording.settings, recording.versions
    minutes = recording.duration_s / 60
    state = "whole" if recording.whole else "cut: the program that wrote it did not end in order"
    if recording.damaged_chunks:
        state = f"damaged: {recording.damaged_chunks} pieces do not hold what was written"
    rows = [
        ("state", state),
        ("began", f"{recording.started:%Y-%m-%d %H:%M:%S} UTC"),
        ("lasted", f"{recording.duration_s:.1f} s"),
        ("subject", str(settings.get("subject") or "not given")),
        ("note", str(settings.get("note") or "none")),
        ("profile", f"{recording.profile.name}, {recording.profile.title}"),
        ("mode", ", ".join(f"{mode} {n:,}" for mode, n in account.modes.items()) or "none"),
        ("source", str(settings.get("sensor"))),
        ("force", str(settings.get("force") or "the source's or the board's")),
        ("board", str(settings.get("board"))),
        ("images", f"{account.messages['/frame']:,}"),
        (
            "sequences",
            f"{account.messages['/sequence']:,}, {account.slots:,} slots; "
            f"{account.acknowledged:,} acknowledged, {account.refused:,} refused, "
            f"{account.lost:,} lost with the board",
        ),
        ("strongest", f"{account.strongest_ma:.2f} mA through one electrode"),
        ("versions", ", ".join(f"{name} {each}" for name, each in versions.items())),
    ]
    size = path.stat().st_size
    rows.append(("file", f"{_size(size)}{_per_minute(size, minutes)}"))
    for topic in sorted(account.size):
        inside = account.size[topic]
        rows.append(
            (
                topic,
                f"{account.messages[topic]:,} messages, {_size(inside)}"
                f"{_per_minute(inside, minutes)} before compression",
            )
        )
    rows += [(f"{at_ns / 1e9:10.3f} s", words) for at_ns, words in recording.events()]
    return rows


def _size(size: float) -> str:
    return f"{size / 1e6:.2f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB"


def _per_minute(size: int, minutes: float) -> str:
    return f", {_size(size / minutes)} a minute" if minutes > 0 else ""
