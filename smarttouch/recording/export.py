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
    there. ``run.npz`` holds ``time_ns`` (N,), ``activation`` (N, 3, E), and of all slots one after
    another ``current_ua`` (S, E), positive cathodic, ``width_us``, ``discharge_us`` and ``site``
    (S,); those of step n are ``first_slot[n]`` to ``first_slot[n + 1]``. Recharge phases are
    ``recharge_us`` (N,) and ``recharge_ua`` (N, E), zero where there is none. Measured voltages are
    ``volts``, one for each slot of the steps in ``volts_step``.
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
    images, arrays = _Images(folder / "frames"), _Arrays()
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
    arrays.save(folder / "run.npz")
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


class _Arrays:
    """Collector of the arrays of one NPZ file."""

    def __init__(self) -> None:
        self._columns: dict[str, list[Any]] = {
            name: []
            for name in (
                "step", "time_ns", "activation", "current_ua", "width_us", "discharge_us", "site",
                "slots", "volts", "volts_step", "recharge_us", "recharge_ua",
            )
        }  # fmt: skip
        self._step_at: dict[int, int] = {}

    def add(self, recorded: RecordedStep) -> None:
        sequence, columns = recorded.step.sequence, self._columns
        columns["step"].append(recorded.index)
        columns["time_ns"].append(recorded.step.input.time_ns)
        columns["activation"].append(recorded.step.tactile.activation)
        columns["slots"].append(sequence.slots)
        for name in ("current_ua", "width_us", "discharge_us", "site"):
            columns[name].append(getattr(sequence, name))
        none = np.zeros(sequence.electrodes, np.int16)
        columns["recharge_us"].append(sequence.recharge_us)
        columns["recharge_ua"].append(
            none if sequence.recharge_ua is None else sequence.recharge_ua
        )
        self._step_at[sequence.time_ns] = recorded.index
        for measured, volts in recorded.step.observed:
            columns["volts"].append(volts)
            columns["volts_step"].append(self._step_at.get(measured.time_ns, -1))

    def save(self, path: Path) -> None:
        columns = self._columns
        joined = ("current_ua", "width_us", "discharge_us", "site", "volts")
        arrays: dict[str, Any] = {
            name: np.concatenate(columns[name]) if columns[name] else np.empty(0) for name in joined
        }
        for name in ("step", "time_ns", "activation", "volts_step", "recharge_us", "recharge_ua"):
            arrays[name] = np.array(columns[name])
        arrays["first_slot"] = np.concatenate([[0], np.cumsum(columns["slots"], dtype=np.int64)])
        with open(path, "xb", opener=owner_only) as file:
            np.savez_compressed(file, **arrays)
