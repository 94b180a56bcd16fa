"""Picture of what the skin got of a texture, below the texture."""

from functools import partial

import numpy as np

from smarttouch.afferent import Afferent
from smarttouch.delivered.drawing import FeltDrawing, Under
from smarttouch.errors import SmartTouchError
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.running.step import StepResult
from smarttouch.texture.texture import Texture


class TextureDrawing(FeltDrawing):
    """Picture of the strongest response at every place: the pulses are too few to average."""

    strongest, longest_px = True, 3000

    def __init__(
        self, profile: Profile, bank: KernelBank, afferents: tuple[Afferent, ...], texture: Texture
    ) -> None:
        super().__init__(profile, bank, afferents)
        self._texture = texture
        self._least, self._most = np.full(2, np.inf), np.full(2, -np.inf)

    def watch(self, sent: StepResult) -> None:
        """Store the pose of a step and the extent of the hand's motion."""
        super().watch(sent)
        place = (sent.input.pose.x_mm, sent.input.pose.y_mm)
        self._least, self._most = np.minimum(self._least, place), np.maximum(self._most, place)

    def under(self) -> Under:
        """Return the part of the texture that the array passed over."""
        if not np.isfinite(self._least).all():
            raise SmartTouchError("the hand felt nothing: there is nothing to draw", about="felt")
        half = np.abs(self._position_mm).max(axis=0) + np.array(self._cell_mm)
        corner, end = self._least - half, self._most + half
        left, top = corner.tolist()
        wide, high = (end - corner).tolist()
        title = f"Under the hand: {self._texture.title}"
        return title, (left, top), (wide, high), partial(self._texture.draw, left, top)
