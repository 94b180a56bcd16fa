"""Recorder of a run into one MCAP file, during the run."""

import json
import platform
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from smarttouch.events import Event
from smarttouch.profile import Profile
from smarttouch.recording.writer import RecordingWriter, name_taken
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult
from smarttouch.version import __version__


class Recorder(Listener):
    """Listener that records a run to a file; see `RecordingWriter`.

    Parameters
    ----------
    path : Path or str
        The file; an existing one is not overwritten.

    Examples
    --------
    See `smarttouch.replay`.
    """

    def __init__(self, path: Path | str) -> None:
        super().__init__()
        self.path = Path(path)
        self._writer: RecordingWriter | None = None

    def prepare(self, run: RunContext) -> None:
        """Raise if the file exists, before the display is opened."""
        if self.path.exists():
            raise name_taken(self.path)

    def start(self, run: RunContext) -> None:
        """Start the file, with the description of the open board."""
        started_unix_ns = time.time_ns()
        about = about_run(run.profile, run.settings, started_unix_ns)
        electrodes = run.profile.electrodes
        self._writer = RecordingWriter(self.path, about, started_unix_ns, electrodes)

    def step(self, result: StepResult) -> None:
        """Queue a step for writing."""
        if self._writer is not None:
            self._writer.record(result)

    def event(self, event: Event) -> None:
        """Queue an event for writing."""
        if self._writer is not None:
            self._writer.event(event.time_ns, str(event))

    def close(self) -> None:
        """Write everything queued, and finish the file."""
        if self._writer is not None:
            self._writer.close()


def about_run(profile: Profile, settings: dict[str, Any], started_unix_ns: int) -> dict[str, str]:
    """Return the description of a run in its recording, with the software versions.

    Of the settings, `RunSettings` are what sequences depend on; all else is for readers.
    """
    versions = {
        "smarttouch": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "scipy": version("scipy"),
        "mcap": version("mcap"),
        "platform": platform.platform(),
    }
    return {
        "started_unix_ns": str(started_unix_ns),
        "profile": profile.model_dump_json(),
        "settings": json.dumps(settings, default=str),
        "versions": json.dumps(versions),
    }
