"""What is kept of a run while it goes, and written when it is over."""

import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.board import Board
from smarttouch.cli.plan import Plan
from smarttouch.kernels.bank import KernelBank
from smarttouch.live import Sent, Tell
from smarttouch.profile import Profile
from smarttouch.sources.frame import Sensor
from smarttouch.stopping import ENDS_WITHIN_S

if TYPE_CHECKING:
    from smarttouch.boards.emulator.simulated import Pulses
    from smarttouch.patterns import PatternFile

DRAWN_WITHIN_S = 30.0
"""After a signal: a second one ends it at once."""


class Drawing(Protocol):
    """Draws what the skin got."""

    def watch(self, sent: Sent) -> None: ...

    def deliver(
        self,
        numbers: NDArray[np.uint32],
        width_us: NDArray[np.float32],
        current_ua: NDArray[np.int16],
    ) -> None: ...

    def save(self, path: Path) -> None: ...


class Kept:
    """The pictures, recordings and outlets that a plan asks for.

    Parameters
    ----------
    plan : Plan
    stack : ExitStack
        What is opened here is closed with it.

    Attributes
    ----------
    observers, tells : list of callable
        Who is told of each step, and of what happens.
    board_options : dict
        What the board has to be made with.
    notes : list of str
        What a user should know of them after the run.
    """

    def __init__(self, plan: Plan, stack: ExitStack) -> None:
        self._plan, self._stack = plan, stack
        self.observers: list[Callable[[Sent], None]] = []
        self.tells: list[Tell] = []
        self.board_options: dict[str, Any] = {}
        self.notes: list[str] = []
        self._drawing: Drawing | None = None
        self._patterns: PatternFile | None = None
        if plan.felt is not None and plan.board_url.startswith("emulator:"):
            folder = tempfile.TemporaryDirectory(prefix="smarttouch-")
            self.board_options["books"] = Path(stack.enter_context(folder))

    @property
    def patience_s(self) -> float:
        """Return how long the end of a run that was stopped may take: pictures take long."""
        drawn = self._plan.felt is not None or self._plan.frames is not None
        return DRAWN_WITHIN_S if drawn else ENDS_WITHIN_S

    @property
    def files(self) -> list[Path]:
        """Return what will have been written at the end."""
        plan = self._plan
        outputs = (plan.felt, plan.frames, plan.record, plan.json_file)
        return [each for each in outputs if each is not None]

    def prepare(self, source: Sensor, profile: Profile, bank: KernelBank) -> None:
        """Begin the pictures and the outlets, which takes long: no board is open yet."""
        plan = self._plan
        if plan.markers:
            self._mark(profile)
        if plan.felt is not None:
            from smarttouch.felt import FeltImage

            own = getattr(source, "drawing", None)
            page = getattr(source, "page", None)
            self._drawing = (
                FeltImage(profile, bank, plan.mode.primaries, page)
                if own is None
                else own(profile, bank)
            )
            self.observers.append(self._drawing.watch)
        if plan.frames is not None:
            from smarttouch.patterns import PatternFile

            self._patterns = PatternFile(plan.frames, profile)
            self.observers.append(self._patterns.watch)

    def open(self, source: Sensor, profile: Profile, board: Board) -> None:
        """Begin the recording, which says what the open board is."""
        plan = self._plan
        if plan.record is not None:
            self._record(plan.record, source, profile, board)

    def _record(self, path: Path, source: Sensor, profile: Profile, board: Board) -> None:
        from smarttouch.recording.recorder import Recorder, about_run

        started_unix_ns = time.time_ns()
        about = about_run(profile, _settings(self._plan, source, board), started_unix_ns)
        recorder = Recorder(path, about, started_unix_ns)
        self._stack.callback(recorder.close)
        self.tells.append(recorder.event)
        self.observers.append(lambda sent: recorder.record(sent, board.acknowledged, board.refused))

    def _mark(self, profile: Profile) -> None:
        from smarttouch.markers import Markers

        markers = Markers(profile)
        self._stack.callback(markers.close)
        markers.notes = self.notes
        self.tells.append(markers.event)
        self.observers.append(markers.watch)

    def finish(self, board: Board) -> None:
        """Write the pictures."""
        plan = self._plan
        if plan.felt is not None and self._drawing is not None:
            self._drawing.deliver(*_delivered(board, self.board_options.get("books")))
            self._drawing.save(plan.felt)
        if self._patterns is not None:
            self._patterns.save()


def _settings(plan: Plan, source: Sensor, board: Board) -> dict[str, Any]:
    """Return all that sequences depend on, and what else one may want to know."""
    return {
        "mode": plan.mode.value,
        "rate_hz": plan.rate_hz,
        "light_on_dark": plan.light_on_dark,
        "softness": plan.softness,
        "tone": None if plan.tone is None else asdict(plan.tone),
        "vibrated": plan.vibrators_url is not None,
        "sharing": {
            "primaries": [each.name for each in plan.sharing.primaries],
            "planned": plan.sharing.planned,
        },
        "hold": plan.hold,
        "balance": plan.balance,
        "recharge": plan.balance and board.capabilities.recharges,
        "timing": asdict(board.timing),
        "compliance_v": board.capabilities.compliance_v,
        "sensor": plan.sensor_url,
        "sensor_title": source.title,
        "board": plan.board_url,
        "vibrators": plan.vibrators_url,
        "firmware": board.capabilities.firmware,
        "force": plan.force_url,
        "seed": plan.seed,
        "subject": plan.subject,
        "note": plan.note,
    }


def _delivered(board: Board, books: Path | None) -> "Pulses":
    """Return every pulse that an emulated board delivered, by its books or as it told."""
    if books is None:
        from smarttouch.boards.emulator.simulated import SimulatedBoard

        electric = getattr(board, "electric", board)
        assert isinstance(electric, SimulatedBoard)
        return electric.take_pulses()
    from smarttouch.boards.emulator.books import read_delivered

    return read_delivered(books)
