"""Summary, repair and export of recordings."""

import contextlib
import csv
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import RecordingError
from smarttouch.base.files import make_folder, owner_only, unwritable, write_bytes
from smarttouch.base.version import __version__
from smarttouch.running.mcap_file import parse_message
from smarttouch.running.recorded_run import ArrayCollector
from smarttouch.running.recorder import new_writer
from smarttouch.running.recording_format import LAST, METADATA
from smarttouch.running.recording_reader import Recording


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

    def add(self, topic: str, data: bytes) -> None:
        """Add one message; an invalid one counts only by its size."""
        self.messages[topic] += 1
        self.size[topic] += len(data)
        with contextlib.suppress(ValueError, TypeError, KeyError, OverflowError):
            if topic == "/sequence":
                fields = parse_message(data)
                self.slots += _count(fields["slots"])
                self.lost += fields["number"] is None
                self.modes[str(fields["mode"])] += 1
                self.strongest_ma = max(self.strongest_ma, float(fields["strongest_ma"]))
            elif topic == LAST:
                fields = parse_message(data)
                self.acknowledged = _count(fields["acknowledged"])
                self.refused = _count(fields["refused"])


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


@dataclass(frozen=True)
class Repaired:
    """Result of a repair: what the new file holds; chunks left out because they are damaged."""

    path: Path
    messages: int
    steps: int
    seconds: float
    damaged_chunks: int


def is_sound(path: Path) -> bool:
    """Return whether a recording has its end, and all its chunks are intact."""
    recording = Recording(path)
    if recording.whole:
        for _ in recording.messages():
            pass
    return recording.whole


def repair(path: Path, output: Path | None = None) -> Repaired:
    """Write the readable part of a recording into a new file; the old one stays as it is.

    The new file is ``NAME-repaired.mcap`` beside the old one if not given. Raises RecordingError if
    the old one is not from SmartTouch, the new one exists, or the disk is full.
    """
    recording = Recording(path)
    output = path.with_name(f"{path.stem}-repaired.mcap") if output is None else output
    messages = steps = 0
    try:
        with open(output, "xb", opener=owner_only) as file:
            writer = new_writer(file)
            writer.start(profile=METADATA, library=f"smarttouch {__version__}")
            writer.add_metadata(METADATA, {**recording.about, "repaired_from": path.name})
            channels: dict[str, int] = {}
            for topic, message in recording.messages():
                if topic not in channels:
                    channel = recording.channels[message.channel_id]
                    schema = recording.schemas.get(channel.schema_id)
                    schema_id = 0
                    if schema is not None:
                        schema_id = writer.register_schema(
                            schema.name, schema.encoding, schema.data
                        )
                    channels[topic] = writer.register_channel(
                        topic, channel.message_encoding, schema_id
                    )
                writer.add_message(
                    channels[topic],
                    log_time=message.log_time,
                    publish_time=message.publish_time,
                    sequence=message.sequence,
                    data=message.data,
                )
                messages += 1
                steps += topic == LAST
            writer.finish()
    except FileExistsError:
        raise RecordingError(
            f"{output} exists: give another file", about="file", remedy="output"
        ) from None
    except OSError as error:
        raise unwritable(RecordingError, output, error) from None
    return Repaired(output, messages, steps, recording.duration_s, recording.damaged_chunks)


def export(path: Path, folder: Path) -> list[Path]:
    """Write a recording into an empty or new folder; return the files, the folder of images first.

    ``frames/`` gets one PNG for each different image. ``steps.csv`` has a row for each step, of all
    in `RunArrays` that has one value for each, and its ``image``; ``events.csv`` has times and
    words. ``run.npz`` holds `RunArrays`, by their names.
    """
    recording = Recording(path)
    try:
        make_folder(folder)
        if any(folder.iterdir()):
            raise RecordingError(
                f"{folder} is not empty: give a folder that is, or a new one", about="file"
            )
        return _export(recording, folder)
    except OSError as error:
        raise unwritable(RecordingError, folder, error) from None


def _export(recording: Recording, folder: Path) -> list[Path]:
    images = _Images(folder / "frames")
    collector = ArrayCollector(len(recording.profile.electrodes))
    names = []
    for recorded in recording.steps():
        names.append(images.save(recorded.step.input.image))
        collector.add(recorded)
    arrays = collector.arrays()
    columns = {name: each.tolist() for name, each in arrays.by_step().items()} | {"image": names}
    with _new(folder / "steps.csv") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    with _new(folder / "events.csv") as file:
        writer = csv.writer(file)
        writer.writerow(("time_ns", "words"))
        writer.writerows(recording.events())
    with open(folder / "run.npz", "xb", opener=owner_only) as packed:
        np.savez_compressed(packed, **vars(arrays))
    return [images.folder, folder / "steps.csv", folder / "events.csv", folder / "run.npz"]


def _new(path: Path) -> TextIO:
    return open(path, "x", newline="", encoding="utf-8", opener=owner_only)


class _Images:
    """Numbers images as they come, and writes each once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._count = 0
        self._last: NDArray[np.uint8] | None = None
        make_folder(folder)

    def save(self, image: NDArray[np.uint8] | None) -> str:
        """Return the name of an image's file; empty if there is no image."""
        if image is None:
            return ""
        if image is not self._last:
            self._last = image
            self._count += 1
            _, png = cv2.imencode(".png", image)
            write_bytes(self.folder / self._name(), png.tobytes(), RecordingError)
        return f"{self.folder.name}/{self._name()}"

    def _name(self) -> str:
        return f"{self._count - 1:06d}.png"
