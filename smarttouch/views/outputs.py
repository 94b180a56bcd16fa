"""The picture of a run: what was delivered, and what a simulated finger makes of it."""

from pathlib import Path
from typing import TYPE_CHECKING

from smarttouch.base.errors import DesignError, SmartTouchError
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.running.step import Listener, RunContext, StepResult

if TYPE_CHECKING:
    from smarttouch.physiology.finger import Finger
    from smarttouch.profile import Profile
    from smarttouch.views.delivered_drawing import DeliveredDrawing


class DeliveredPicture(Listener):
    """Draws what was delivered, and the response of a finger, below what the finger passed over.

    The board must report every pulse: ``simulated:``. Where no finger can be made
    of a profile, a note says so, and what was delivered is drawn alone.
    """

    def __init__(self, path: Path, finger: int = 1, anatomy: str | Path = "branched") -> None:
        super().__init__()
        self.path = path
        self._seed, self._anatomy = finger, anatomy
        self._drawing: DeliveredDrawing | None = None
        self._driver: SimulatedDriver | None = None

    def prepare(self, run: RunContext) -> None:
        """Begin the picture, and make the board log its pulses."""
        from smarttouch.physiology.anatomy import load_anatomy

        if self.path.suffix.lower() not in ("", ".png"):
            raise SmartTouchError(f"{self.path} cannot be drawn: name a .png")
        load_anatomy(self._anatomy)
        if not isinstance(run.board.driver, SimulatedDriver):
            raise SmartTouchError(
                "this picture needs a board that reports every pulse, and this one "
                "does not: use the board simulated:"
            )
        self._driver = run.board.driver
        own = getattr(run.source, "drawing", None)
        if own is not None:
            self._drawing = own(run.profile, run.bank)
        else:
            from smarttouch.views.delivered_drawing import PageDrawing

            afferents = run.controls.state(0).mode.afferents
            self._drawing = PageDrawing(run.profile, run.bank, afferents, lambda: run.source.sheet)

    def step(self, result: StepResult) -> None:
        """Store the place of the finger."""
        if self._drawing is not None:
            self._drawing.watch(result)

    def finish(self, run: RunContext) -> None:
        """Draw the delivered pulses."""
        assert self._drawing is not None
        assert self._driver is not None
        self._drawing.deliver(*self._driver.take_pulses(), self._finger(run.profile))
        self._drawing.save(self.path)

    def _finger(self, profile: "Profile") -> "Finger | None":
        from smarttouch.physiology.finger import Finger

        try:
            finger = Finger(profile, self._seed, self._anatomy)
            _ = finger.rows
        except DesignError as error:
            self.notes.append(f"the picture shows what was delivered, and no finger: {error}")
            return None
        return finger
