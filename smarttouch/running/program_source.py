"""A program as the source of a run: it shows patterns one after another, in a thread of its own."""

import threading
from abc import abstractmethod

from smarttouch.profile import Profile
from smarttouch.running.session_feed import SessionFeed
from smarttouch.running.touch import Touch
from smarttouch.sources.source_contract import Input


class ProgramSource(SessionFeed):
    """Source whose `program` is a user of a session, as programs of `Display.session` are.

    The run ends with it, and raises what it raises.
    """

    fixed_mode = True
    ended = "the program has ended"

    def __init__(self, title: str, profile: Profile) -> None:
        super().__init__(profile, title)
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._go, name="program", daemon=True)

    @abstractmethod
    def program(self, touch: Touch) -> None:
        """Show what there is to show."""

    def read(self, time_ns: int) -> Input | None:
        """Return what the program shows now, from the first read on; None once it has ended."""
        if self._thread.ident is None and not self.is_over:
            self._thread.start()
        given = super().read(time_ns)
        if given is None and self._failed is not None:
            raise self._failed
        return given

    def close(self) -> None:
        """End the program at what it shows next."""
        super().close()
        if self._thread.is_alive():
            self._thread.join()

    def _go(self) -> None:
        try:
            self.program(Touch(self))
        except BaseException as error:
            # What is shown when a run is over raises.
            if not self.is_over:
                self._failed = error
        finally:
            self.end()
