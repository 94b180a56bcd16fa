"""Program that makes the recordings for replay tests: ``python -m tests.running.make_goldens``.

Arguments name the recordings to make, for example ``shared ra``; the default is all of them.

Each recording is a run over a line of print, on a board in memory, in simulated time. Make new
recordings only after an intended change of sequences, and explain the change in the commit.
"""

import sys
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import LineLostError
from smarttouch.boards.kits.kajimoto61 import Kajimoto61Driver
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.profile import load_profile
from smarttouch.running import recorder as writer_module
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.loop import Controls, ControlState
from smarttouch.running.recorder import Recorder
from smarttouch.running.runner import Runner
from smarttouch.sources import open_source
from smarttouch.sources.source_contract import Frame, Source, Stimulus
from smarttouch.stimulation.scan_sequence import ScanTiming, SlotPolicy

from ..support.scans import board_without_finger

FOLDER = Path(__file__).parent / "goldens"
IMAGES = 8
"""Number of images in a recording. The camera is slower than the loop, to keep files small."""
BEGIN, END = 0.68, 0.94
"""Recording covers these fractions of the path's duration, to skip most of the margin."""


@dataclass(frozen=True)
class Golden:
    """Description of a run to record."""

    name: str
    mode: Mode
    text: str
    seconds: float
    settings: dict[str, Any] = field(default_factory=dict)  # fields of `RunConfig`
    profile: str = "electric-mouse"
    timing: ScanTiming = field(default_factory=ScanTiming)
    wishes: tuple[tuple[float, ControlState], ...] = ()  # start in s and state of the controls
    lost_at: int | None = None  # number of the sequence at which the board is lost
    has_stimuli: bool = False  # whether the source gives stimuli instead of frames


GOLDENS = (
    Golden("ra", Mode.RA, "on", 1.0, {"rate_hz": 20}),
    Golden(
        "sai-levels", Mode.SAI, "if", 1.5, {"rate_hz": 25, "softness": 0.3},
        wishes=(
            (0.6, ControlState(Mode.SAI, 0.4)),
            (0.9, ControlState(Mode.SAI, 0.4, paused=True)),
            (1.1, ControlState(Mode.SAI, 0.8)),
        ),
    ),
    Golden("natural", Mode.NATURAL, "t", 0.9, wishes=((0.7, ControlState(Mode.RA)),)),
    Golden("kajimoto", Mode.RA, "no", 1.0, profile="kajimoto-61", timing=Kajimoto61Driver.timing),
    Golden(
        "regulated", Mode.RA, "l", 1.2,
        {"rate_hz": 20, "hold": "energy", "balance": True, "light_on_dark": True}, lost_at=14,
    ),
    Golden("pc", Mode.PC, "up", 1.0, {"rate_hz": 20}),
    Golden("color", Mode.COLOR, "o", 0.9, has_stimuli=True),
    # Like scan=auto: RA points share slots, and SAI points follow in slots of their own.
    Golden(
        "shared", Mode.NATURAL, "m", 0.7, {"scan": SlotPolicy((Afferent.RA,))},
        wishes=((0.55, ControlState(Mode.RA)),),
    ),
)  # fmt: skip


class SlowCamera(Source):
    """Sensor that repeats each image in several frames. It gives stimuli if ``has_stimuli``."""

    knows_force = True

    def __init__(self, sensor, golden):
        super().__init__(sensor.title)
        self._sensor, self._golden, self._number = sensor, golden, -1

    def read(self, time_ns):
        share = BEGIN + (END - BEGIN) * time_ns / (self._golden.seconds * 1e9)
        found = self._sensor.read(int(share * self._sensor.duration_s * 1e9))
        if found is None:
            return None
        number = int(time_ns / (self._golden.seconds * 1e9) * IMAGES)
        if number != self._number:
            self._number = number
            inverted = "light_on_dark" in self._golden.settings
            self._image = 255 - found.image if inverted else found.image
        if not self._golden.has_stimuli:
            return Frame(self._image, time_ns, found.pose, found.force_n, self._number)
        activation, period_us = self._random_stimulus(time_ns)
        return Stimulus(
            activation, time_ns, found.force_n, period_us, 0.8,
            pose=found.pose, number=self._number, image=self._image,
        )  # fmt: skip

    def _random_stimulus(self, time_ns):
        """Return activation of all classes at a few electrodes, and a period of 20 to 40 ms."""
        random = np.random.default_rng(time_ns)
        activation = random.random((len(Afferent), 64), np.float32)
        activation[random.random(activation.shape) > 0.04] = 0
        return activation, int(random.integers(20_000, 40_000))


class Script(Controls):
    """Controls that change at the times in a golden's ``wishes``."""

    def __init__(self, golden, *_):
        super().__init__(ControlState(golden.mode))
        self._wishes = [(0.0, ControlState(golden.mode)), *golden.wishes]

    def state(self, time_ns):
        return [each for after_s, each in self._wishes if time_ns >= after_s * 1e9][-1]


class GoldenDriver(MemoryDriver):
    """In-memory board that is lost at most once. With ``hold``, it measures rising impedance."""

    def __init__(self, golden, *given):
        super().__init__(*given)
        self.timing, self._lost_at = golden.timing, golden.lost_at
        self._measures = "hold" in golden.settings

    def open(self, line, limits):
        can = super().open(line, limits)
        return replace(can, measures=self._measures, compliance_v=100.0)

    def write(self, proved):
        if len(self.sequences) == self._lost_at:
            self._lost_at = None
            raise LineLostError("the board in memory was lost")
        super().write(proved)
        if proved.sequence.slots and self._measures:
            kohm = 1.0 + 0.1 * len(self.sequences)
            volts = np.abs(proved.sequence.current_ua).max(axis=1) * kohm / 1000
            self._line.measured(proved.sequence, volts.astype(np.float32))


def make(golden, path):
    profile = load_profile(golden.profile)
    board = board_without_finger(profile, partial(GoldenDriver, golden), simulated_time=True)
    config = RunConfig(
        **{"scan": "points", "subject": "nobody", "note": "a golden of the tests"}
        | golden.settings, mode=golden.mode, seconds=golden.seconds,
    )  # fmt: skip
    with open_source(f"text:{golden.text}", profile) as page:
        Runner(
            SlowCamera(page, golden), Display(board, profile), config, listeners=[Recorder(path)],
            controls=partial(Script, golden),
        ).run()  # fmt: skip


def main(names):
    # A single chunk compresses better, and its content does not depend on the computer's speed.
    writer_module.CHUNK_S = 3600.0
    FOLDER.mkdir(exist_ok=True)
    for golden in GOLDENS:
        if names and golden.name not in names:
            continue
        path = FOLDER / f"{golden.name}.mcap"
        path.unlink(missing_ok=True)
        make(golden, path)
        print(f"{path.name}: {path.stat().st_size / 1000:.1f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
