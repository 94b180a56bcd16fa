"""Makes the recordings that replay is tested with: ``python tests/running/make_goldens.py``.

With names it makes these alone: ``make_goldens.py shared ra``.

Each is a run of the real loop over a printed page, into a board in memory, by a clock of its own.
Make them anew only where sequences are meant to change, and say so.
"""

import json
import sys
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from smarttouch import __version__
from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.errors import LineLostError
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.kits.kajimoto61 import Kajimoto61Driver
from smarttouch.boards.open import MemoryDriver
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running import recorder as writer_module
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.loop import Loop
from smarttouch.running.pipeline import Pipeline, Regulator
from smarttouch.running.recorder import Recorder
from smarttouch.running.recording_format import about_run, digest_of
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import OnEvent, OnStep
from smarttouch.sources import open_source
from smarttouch.sources.source_contract import Frame, Source, Stimulus
from smarttouch.stimulation.adaptation import Adaptation
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.recharge import ChargeBalance
from smarttouch.stimulation.scan_sequence import NO_SHARING, SlotPolicy

from ..support.scans import board_without_finger

FOLDER = Path(__file__).parent / "goldens"
STARTED_UNIX_NS = 1_700_000_000 * 10**9
IMAGES = 8
"""In each, as of a camera that is slower than the loop: files stay small."""
BEGIN, END = 0.68, 0.94
"""Of the way of the finger: most of the margin is left out."""


@dataclass(frozen=True)
class Golden:
    """One run, and what it is for."""

    name: str
    profile: str
    mode: Mode
    text: str
    seconds: float
    rate_hz: float | None = None
    softness: float | None = None
    light_on_dark: bool = False
    hold: str | None = None
    balance: bool = False
    timing: ScanTiming = field(default_factory=ScanTiming)
    wishes: tuple[tuple[float, ControlState], ...] = ()
    lost_at: int | None = None
    asks: bool = False
    sharing: SlotPolicy = NO_SHARING


GOLDENS = (
    Golden("ra", "electric-mouse", Mode.RA, "on", 1.0, rate_hz=20),
    Golden(
        "sai-levels", "electric-mouse", Mode.SAI, "if", 1.5, rate_hz=25, softness=0.3,
        wishes=(
            (0.6, ControlState(Mode.SAI, 0.4)),
            (0.9, ControlState(Mode.SAI, 0.4, paused=True)),
            (1.1, ControlState(Mode.SAI, 0.8)),
        ),
    ),
    Golden(
        "natural", "electric-mouse", Mode.NATURAL, "t", 0.9, wishes=((0.7, ControlState(Mode.RA)),)
    ),
    Golden("kajimoto", "kajimoto-61", Mode.RA, "no", 1.0, timing=Kajimoto61Driver.timing),
    Golden(
        "regulated", "electric-mouse", Mode.RA, "l", 1.2, rate_hz=20, hold="energy", balance=True,
        light_on_dark=True, lost_at=14,
    ),
    Golden("pc", "electric-mouse", Mode.PC, "up", 1.0, rate_hz=20),
    Golden("color", "electric-mouse", Mode.COLOR, "o", 0.9, asks=True),
    # As --scan auto: kernels of RA are added up, those of SAI stand alone behind them.
    Golden(
        "shared", "electric-mouse", Mode.NATURAL, "m", 0.7, wishes=((0.55, ControlState(Mode.RA)),),
        sharing=SlotPolicy((Afferent.RA,)),
    ),
)  # fmt: skip


class Held(Source):
    """A sensor whose images stay for a few looks."""

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
            self._image = 255 - found.image if self._golden.light_on_dark else found.image
        if not self._golden.asks:
            return Frame(self._image, time_ns, found.pose, found.force_n, self._number)
        activation, period_us = self._asked(time_ns)
        return Stimulus(
            activation, time_ns, found.force_n, period_us, 0.8,
            pose=found.pose, number=self._number, image=self._image,
        )  # fmt: skip

    def _asked(self, time_ns):
        """Return all three classes here and there, each time for another while."""
        random = np.random.default_rng(time_ns)
        activation = random.random((len(Afferent), 64), np.float32)
        activation[random.random(activation.shape) > 0.04] = 0
        return activation, int(random.integers(20_000, 40_000))


class Script(Controls):
    """A user who does the same at the same time in each run."""

    def __init__(self, golden):
        super().__init__(ControlState(golden.mode))
        self._wishes = [(0.0, ControlState(golden.mode)), *golden.wishes]

    def state(self, time_ns):
        return [each for after_s, each in self._wishes if time_ns >= after_s * 1e9][-1]


class GoldenDriver(MemoryDriver):
    """A board in memory that can be lost once; where it matters it measures skin that dries out."""

    def __init__(self, golden, *given):
        super().__init__(*given)
        self.timing, self._lost_at = golden.timing, golden.lost_at
        self._measures = golden.hold is not None

    def open(self, line, limits):
        return replace(super().open(line, limits), measures=self._measures)

    def write(self, proved):
        if len(self.sequences) == self._lost_at:
            self._lost_at = None
            raise LineLostError("the board in memory was lost")
        super().write(proved)
        if proved.sequence.slots and self._measures:
            kohm = 1.0 + 0.1 * len(self.sequences)
            volts = np.abs(proved.sequence.current_ua).max(axis=1) * kohm / 1000
            self._line.events.volts(proved.sequence, volts.astype(np.float32))


def make(golden, path):
    """Record one."""
    profile = load_profile(golden.profile)
    settings = {
        "mode": golden.mode.value, "rate_hz": golden.rate_hz, "light_on_dark": golden.light_on_dark,
        "softness": golden.softness, "hold": golden.hold, "balance": golden.balance,
        "timing": asdict(golden.timing), "compliance_v": 100.0, "sensor": f"text:{golden.text}",
        "board": "memory:", "force": None, "seed": 0, "subject": "nobody",
        "note": "a golden of the tests",
    }  # fmt: skip
    if golden.sharing != NO_SHARING:
        settings["sharing"] = {
            "primaries": [each.name for each in golden.sharing.afferents],
        }
    about = about_run(profile, settings, STARTED_UNIX_NS)
    about["versions"] = json.dumps({"smarttouch": __version__})
    about["digest"] = digest_of(about)
    pipeline = Pipeline(
        profile,
        load_bank(profile),
        RunConfig(
            mode=golden.mode,
            rate_hz=golden.rate_hz,
            light_on_dark=golden.light_on_dark,
            softness=golden.softness,
            scan=golden.sharing,
            balance=golden.balance,
        ),
        golden.timing,
    )
    pipeline.regulator = Regulator(
        Adaptation(profile, golden.hold, 100.0) if golden.hold else None,
        ChargeBalance(len(profile.electrodes)) if golden.balance else None,
    )
    board = board_without_finger(profile, partial(GoldenDriver, golden))
    recorder = Recorder(path)
    recorder.begin(about, STARTED_UNIX_NS)
    with open_source(f"text:{golden.text}", profile) as page, board:
        Loop(
            Held(page, golden), pipeline, board, stop=StopRequest(), statistics=RunStatistics(),
            seconds=golden.seconds, controls=Script(golden),
            clock=SimulatedClock(),
            listeners=[
                OnStep(lambda sent: recorder.step(replace(sent, work_us=0.0))),
                OnEvent(recorder.event),
            ],
        ).run()  # fmt: skip
    recorder.close()


def main(names):
    # One chunk compresses better, and depends on no clock.
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
