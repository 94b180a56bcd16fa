"""Pages of a study: each is delivered once for a choice, and read on every finger."""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from smarttouch.afferent import Afferent, Mode
from smarttouch.physiology.anatomy import Anatomy
from smarttouch.reading.deliver import Reading
from smarttouch.reading.legibility import Legibility, legibility_of_shapes, legibility_on_finger
from smarttouch.reading.shapes import Shapes, Style
from smarttouch.reading.source import Source
from smarttouch.reading.window import profile_for_reading
from smarttouch.running.config import RunConfig
from smarttouch.studies.grid import Choice, Grid
from smarttouch.studies.rows import Row

_SHAPES = Shapes(Style.GRADED)


@dataclass(frozen=True)
class ShownPage:
    """One page in one choice."""

    grid: Grid
    choice: Choice
    page: str  # as the study names it

    @cached_property
    def reading(self) -> Reading:
        profile, bank = self.grid.bank(self.choice)
        window = profile_for_reading(profile)
        sharing = RunConfig(scan=self.choice.scan).sharing(window)
        return Reading(
            window, bank, _SHAPES.tone, _SHAPES.motion(window), Mode(self.choice.mode), sharing,
            self.choice.intensity,
        )  # fmt: skip

    @cached_property
    def delivered(self) -> Legibility:
        """Delivered lines, and the truth: the text that Tesseract reads of the page itself."""
        source = Source(str(self.grid.file(self.page)))
        return legibility_of_shapes(source, self.reading, _SHAPES, source.words)

    def digest(self) -> str:
        """Return a hash of all that its rows depend on, but for the finger."""
        found = hashlib.sha256(repr((self.choice, self.page)).encode())
        place = Path(self.grid.file(self.page))
        found.update(place.read_bytes() if place.is_file() else b"")
        profile, bank = self.grid.bank(self.choice)
        found.update(profile.model_dump_json().encode())
        for each in Afferent:
            if each in bank.weights:
                found.update(bank.kernels(each).tobytes())
        return found.hexdigest()


def row_of_page(
    found: Legibility, reading: Reading, choice: Choice, page: str, anatomy: Anatomy, name: str,
    seed: int,
) -> list[Row]:  # fmt: skip
    """Return what one finger reads of a page that was delivered; counts are not taken."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        felt, error = legibility_on_finger(found, reading, seed, anatomy)
    slots = [line.current_ua for lines, _ in found.delivered for line in lines]
    return [Row.of(choice, name, seed, page, felt, slots, error)]
