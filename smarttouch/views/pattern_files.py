"""Activation of the electrodes, step by step, as pictures, a film, or numbers."""

import json
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from smarttouch.base.array_picture import NEUTRAL, ElectrodePicture
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import make_folder, write_bytes
from smarttouch.profile import Profile
from smarttouch.running.step import StepResult

_PITCH_PIXELS = 24
_SMALLEST_PIXELS = 6
_LARGEST_PICTURE = 480
_DIGITS = 3
FORMATS = ".gif, .json, or the name of a folder for PNG files"


class PatternFile:
    """Activation of each step of a run, kept and written to files.

    The path ends in ``.gif`` or ``.json``, else it is an empty or new folder of PNG files.
    """

    def __init__(self, path: Path, profile: Profile) -> None:
        if path.suffix not in ("", ".gif", ".json"):
            raise SmartTouchError(f"cannot write {path}: give {FORMATS}", about="file")
        if not path.suffix and path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise SmartTouchError(
                f"{path} is there and not empty: give another folder", about="file"
            )
        self._path, self._profile = path, profile
        self._activation: list[NDArray[np.uint8]] = []
        self._period_us: list[int] = []

    def watch(self, sent: StepResult) -> None:
        """Keep the activation of a step, zero where there is no current."""
        tactile, sequence = sent.step.tactile, sent.step.sequence
        active = tactile.activation.max(axis=0) * (sequence.intensity > 0)
        self.add(np.rint(255 * active).astype(np.uint8), sequence.period_us)

    def add(self, level: NDArray[np.uint8], period_us: int) -> None:
        """Keep an activation, (E,), 255 the strongest, for a time."""
        self._activation.append(level)
        self._period_us.append(period_us)

    def save(self) -> None:
        """Write all files; raises if there are no steps, or they cannot be written."""
        if not self._activation:
            raise SmartTouchError("there were no steps: nothing can be written", about="patterns")
        try:
            {".gif": self._save_film, ".json": self._save_numbers, "": self._save_pictures}[
                self._path.suffix
            ]()
        except OSError as error:
            raise SmartTouchError(
                f"cannot write {self._path}: {error.strerror or error}", about="file"
            ) from None

    def _save_numbers(self) -> None:
        electrodes = self._profile.electrodes
        starts_us = np.cumsum([0, *self._period_us[:-1]])
        steps: list[dict[str, Any]] = [
            {"time_ms": float(start) / 1000, "activation": (row / 255).round(_DIGITS).tolist()}
            for start, row in zip(starts_us, self._activation, strict=True)
        ]
        document = {
            "profile": self._profile.name,
            "electrodes": [
                {"x_mm": round(float(x), 6), "y_mm": round(float(y), 6)}
                for x, y in electrodes.position_mm
            ],
            "steps": steps,
        }
        write_bytes(self._path, (json.dumps(document) + "\n").encode())

    def _save_pictures(self) -> None:
        make_folder(self._path)
        draw = self._painter()
        for number, row in enumerate(self._activation):
            picture = BytesIO()
            draw(row).save(picture, format="PNG")
            write_bytes(self._path / f"step-{number:06d}.png", picture.getvalue())

    def _save_film(self) -> None:
        draw = self._painter()
        first, *others = (draw(row) for row in self._activation)
        # A film's clock counts hundredths of a second.
        ends = np.rint(np.cumsum(self._period_us) / 10_000).astype(int)
        durations = 10 * np.maximum(np.diff(ends, prepend=0), 1)
        film = BytesIO()
        first.save(
            film,
            format="GIF",
            save_all=True,
            append_images=others,
            duration=durations.tolist(),
            loop=0,
        )
        write_bytes(self._path, film.getvalue())

    def _painter(self) -> Callable[[NDArray[np.uint8]], Image.Image]:
        """Return what draws the array with every electrode as dark as it is active."""
        electrodes = self._profile.electrodes
        pitch_mm = min(electrodes.cell_mm)
        scale = min(_PITCH_PIXELS / pitch_mm, _LARGEST_PICTURE / max(electrodes.extent_mm))
        picture = ElectrodePicture(electrodes, max(scale, _SMALLEST_PIXELS / pitch_mm))

        def draw(level: NDArray[np.uint8]) -> Image.Image:
            colors = np.array(NEUTRAL) * (1 - level[:, None] / 255)
            return Image.fromarray(picture.raster(colors.astype(np.uint8))).convert("L")

        return draw
