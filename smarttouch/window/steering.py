"""Steering of a run by pages: several look, one has control, any can stop it."""

import threading
import time
from collections.abc import Callable, Mapping

from smarttouch.afferent import Mode
from smarttouch.running.controls import STEP, Controls
from smarttouch.stopping import StopRequest

LOST_S = 0.7  # silence after which a page loses control


class Steering:
    """Passes one page's requests to the controls of a run, as keys do. A page takes control by a
    request if no other has it. A run that no page controls any more is paused unless it has other
    controls (not ``alone``)."""

    def __init__(
        self,
        controls: Controls,
        stop: StopRequest,
        keys: Mapping[str, Callable[[], None]],
        *,
        alone: bool,
    ) -> None:
        self.controls, self._stop, self._keys, self._alone = controls, stop, keys, alone
        self._page: int | None = None
        self._alive_s = 0.0
        self._lock = threading.Lock()
        self._does: dict[str, Callable[[], None]] = {
            "more": lambda: controls.change_level(STEP),
            "less": lambda: controls.change_level(-STEP),
            "none": controls.silence,
            "pause": controls.pause,
            "resume": controls.resume,
        }

    @property
    def page(self) -> int | None:
        """Number of the page that steers; None if none does."""
        return self._page

    def stop(self) -> None:
        """End the run with all electrodes at zero; any page may."""
        self._stop.ask("the window")

    def steer(self, page: int) -> bool:
        """Return whether a page has control; it takes it if no other has."""
        with self._lock:
            if self._page is None:
                self._alive_s, self._page = time.monotonic(), page
            return self._page == page

    def leave(self, page: int) -> None:
        """Release control, if this page has it."""
        with self._lock:
            if self._page != page:
                return
            self._page = None
        if self._alone:
            self.controls.pause()

    def note_alive(self, page: int) -> None:
        if self._page == page:
            self._alive_s = time.monotonic()

    def look_after(self) -> None:
        """Release the control of a page that has fallen silent; from any thread."""
        page = self._page
        if page is not None and time.monotonic() - self._alive_s > LOST_S:
            self.leave(page)

    def act(self, page: int, what: str) -> bool:
        """Execute a page's request; return False if another has control, raise ValueError if it is
        unknown."""
        kind, _, name = what.partition(":")
        if what in self._does:
            does = self._does[what]
        elif kind == "mode" and name in {str(each) for each in self.controls.modes}:
            mode = Mode(name)

            def does() -> None:
                self.controls.choose_mode(mode)

        elif kind == "key" and name in self._keys:
            does = self._keys[name]
        else:
            raise ValueError(what)
        if not self.steer(page):
            return False
        does()
        return True
