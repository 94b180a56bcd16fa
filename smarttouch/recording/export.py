"""Export of a recording to other programs: images as PNG, tables as CSV, arrays as NPZ."""

import csv
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import RecordingError
from smarttouch.files import make_folder, owner_only, unwritable, write_bytes
from smarttouch.recording.decoder import RecordedStep
from smarttouch.recording.reader import Recording
from smarttouch.recording.recorded_run import ArrayCollector

TABLES = {
    "finger": ("step", "time_ns", "image", "x_mm", "y_mm", "angle_rad", "force_n", "age_ns",
               "stale"),
    "sequence": ("step", "time_ns", "sent", "mode", "level", "restarted", "intensity",
                 "asked_us", "period_us", "slots", "strongest_ua"),
    "board": ("step", "time_ns", "sent", "acknowledged", "refused", "latency_us", "work_us"),
}  # fmt: skip
"""Columns of each table; `events.csv` has ``time_ns`` and ``words``."""


def export(path: Path, folder: Path) -> list[Path]:
    """Write a recording into an empty or new folder; return the files, the folder of images first.

    ``frames/`` gets one PNG for each different image; ``finger.csv`` says at which steps it was
    there. ``run.npz`` holds `RunArrays`, by their names.
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
    arrays = ArrayCollector(len(recording.profile.electrodes))
    with ExitStack() as stack:
        tables = {}
        for name, columns in TABLES.items():
            path = folder / f"{name}.csv"
            file = stack.enter_context(_new(path))
            tables[name] = csv.writer(file)
            tables[name].writerow(columns)
        for recorded in recording.steps():
            name = images.save(recorded.step.input.image)
            for table, row in _rows(recorded, name).items():
                tables[table].writerow((recorded.index, recorded.step.input.time_ns, *row))
            arrays.add(recorded)
    with _new(folder / "events.csv") as file:
        writer = csv.writer(file)
        writer.writerow(("time_ns", "words"))
        writer.writerows(recording.events())
    with open(folder / "run.npz", "xb", opener=owner_only) as packed:
        np.savez_compressed(packed, **vars(arrays.arrays()))
    written = [folder / f"{name}.csv" for name in (*TABLES, "events")]
    return [images.folder, *written, folder / "run.npz"]


def _rows(recorded: RecordedStep, image: str) -> dict[str, Sequence[Any]]:
    step, sent = recorded.step, recorded.sent
    given, sequence, pose = step.input, step.sequence, step.input.pose
    strongest_ua = int(np.abs(sequence.current_ua.astype(np.int32)).max(initial=0))
    return {
        "finger": (
            image, pose.x_mm, pose.y_mm, pose.angle_rad, given.force_n, given.age_ns, given.stale,
        ),
        "sequence": (
            sent.number, step.mode.value, step.level, step.restarted, sequence.intensity,
            step.asked_us, sequence.period_us, sequence.slots, strongest_ua,
        ),
        "board": (
            sent.number, recorded.acknowledged, recorded.refused, sent.latency_us, sent.work_us,
        ),
    }  # fmt: skip


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
