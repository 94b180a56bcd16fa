"""Motion of the pointer over a texture on the browser page of a run."""

from smarttouch.base.errors import SourceError
from smarttouch.instruments.hand_motion import HandMotion
from smarttouch.instruments.textures import Texture
from smarttouch.pages.page_image import Page
from smarttouch.sources.source_contract import Sheet

_UNBOUNDED_MM = (150.0, 100.0)  # part that is shown of a texture without ends
_LONGEST_PX = 1000
_ROUNDING_MM = 1.0  # by which a page may be off at the edges


class PageMotion(HandMotion):
    """Motion of the pointer, from the middle of the texture, which the page shows as `sheet`."""

    resolution_mm = 0.25  # about a pixel of the page

    def __init__(self, texture: Texture) -> None:
        super().__init__("the pointer over the page")
        wide, high = texture.size_mm or _UNBOUNDED_MM
        middle = texture.middle_mm
        corner = (middle[0] - wide / 2, middle[1] - high / 2)
        pixel_mm = max(wide, high) / _LONGEST_PX
        shape = (max(1, round(high / pixel_mm)), max(1, round(wide / pixel_mm)))
        picture = Page(texture.draw(*corner, shape, pixel_mm), pixel_mm)
        self.sheet = Sheet(1, picture, corner)
        self.is_shown = False  # whether a window shows the sheet
        self.origin_mm: tuple[float, float] = middle
        # The page's thread replaces the tuple at once, so it needs no lock.
        self._place_mm = middle

    def move(self, x_mm: float, y_mm: float) -> None:
        """Move the hand to a place on the texture; ValueError if the sheet does not show it."""
        sides = zip((x_mm, y_mm), self.sheet.corner_mm, self.sheet.page.size_mm, strict=True)
        if not all(-_ROUNDING_MM <= at - low <= size + _ROUNDING_MM for at, low, size in sides):
            raise ValueError(f"{x_mm:g}, {y_mm:g} mm is not on the texture")
        self._place_mm = (x_mm, y_mm)

    def read(self, time_ns: int) -> tuple[float, float]:
        """Return the displacement of the pointer from the middle."""
        if not self.is_shown:
            raise SourceError("motion=page follows the pointer over a run's page: open its window")
        x, y = self._place_mm
        return x - self.origin_mm[0], y - self.origin_mm[1]
