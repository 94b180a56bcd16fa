"""Speech and tones of a run, by way of speech-dispatcher."""

import contextlib
import io
import os
import queue
import shutil
import subprocess
import tempfile
import threading
import wave
from collections.abc import Callable
from pathlib import Path

import numpy as np

from smarttouch.errors import SmartTouchError
from smarttouch.events import Event
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult

INSTALL = "apt install speech-dispatcher alsa-utils"
TONES_HZ = {"first": 660.0, "second": 990.0}
"""Tones that mark the intervals of an experiment, by the end of its title."""
TONE_S = 0.1
_COMMAND = "!-!"
"""Beginning of a line that spd-say would take for a command."""
_LAST_WORDS_S = 0.5
_RATE_HZ = 16_000


class Speech(Listener):
    """Says the titles of the source and the events of a run, from a thread of its own.

    Parameters
    ----------
    hides : callable
        Returns whether an event is not to be said.

    Raises
    ------
    SmartTouchError
        If there is no speech-dispatcher.
    """

    def __init__(self, hides: Callable[[Event], bool] = lambda _event: False) -> None:
        super().__init__()
        if shutil.which("spd-say") is None:
            raise SmartTouchError(
                f"speech-dispatcher is not here: {INSTALL}, or run without speech",
                about="speech",
                problem="missing",
                remedy=INSTALL,
            )
        self._hides = hides
        self._waiting: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._name = self._said = ""

    def prepare(self, run: RunContext) -> None:
        """Begin to speak."""
        self._source = run.source
        self._name = self._said = run.source.title
        self._waiting.put(self._name)
        self._thread = threading.Thread(target=self._speak, name="speech", daemon=True)
        self._thread.start()

    def step(self, result: StepResult) -> None:
        """Say a new title, without what it began with."""
        title = self._source.title
        if title != self._said:
            self._said = title
            self._waiting.put(title.removeprefix(self._name).lstrip(",: ") or title)

    def event(self, event: Event) -> None:
        """Say an event."""
        if not self._hides(event):
            self._waiting.put(str(event))

    def close(self) -> None:
        """Say what is left, and be silent."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._waiting.put(None)
            thread.join(_LAST_WORDS_S)

    def _speak(self) -> None:
        with contextlib.ExitStack() as stack:
            tones = _tones(Path(stack.enter_context(tempfile.TemporaryDirectory())))
            speaker = subprocess.Popen(
                ["spd-say", "-N", "smarttouch", "-e"],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "LC_CTYPE": "C.UTF-8"},
                text=True,
                encoding="utf-8",
                errors="replace",
                # Ctrl-C is for the run, whose end it is to say.
                start_new_session=True,
            )
            stack.callback(_left, speaker)
            assert speaker.stdin is not None
            while (words := self._waiting.get()) is not None:
                tone = tones.get(words.rpartition(": ")[2])
                if tone is not None and _play(tone):
                    continue
                line = " ".join(words.split())
                if line.startswith(_COMMAND):
                    line = line.lstrip(_COMMAND)
                try:
                    speaker.stdin.write(f"{line}\n")
                    speaker.stdin.flush()
                except OSError:
                    # Without speech the run goes on.
                    self.notes.append("speech-dispatcher has ended: nothing was said any more")
                    return


def _left(speaker: "subprocess.Popen[str]") -> None:
    """Let a program end by itself: it hands over what it has been given."""
    try:
        speaker.communicate(timeout=_LAST_WORDS_S)
    except (OSError, subprocess.TimeoutExpired):
        speaker.kill()
        speaker.wait()


def _play(tone: Path) -> bool:
    """Play a tone; return whether there is a program that does."""
    if shutil.which("aplay") is None:
        return False
    subprocess.run(["aplay", "-q", str(tone)], check=False, stderr=subprocess.DEVNULL)
    return True


def _tones(folder: Path) -> dict[str, Path]:
    """Write the tones into a folder, and return their files."""
    time_s = np.arange(round(TONE_S * _RATE_HZ)) / _RATE_HZ
    swell = np.minimum(1, np.minimum(time_s, TONE_S - time_s) / 0.01)
    for name, tone_hz in TONES_HZ.items():
        data = io.BytesIO()
        with wave.open(data, "wb") as file:
            file.setparams((1, 2, _RATE_HZ, 0, "NONE", ""))
            sound = 12_000 * swell * np.sin(2 * np.pi * tone_hz * time_s)
            file.writeframes(sound.astype("<i2").tobytes())
        (folder / f"{name}.wav").write_bytes(data.getvalue())
    return {name: folder / f"{name}.wav" for name in TONES_HZ}
