"""What the skin felt, drawn in the world: delivered pulses where the electrodes were."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import SmartTouchError
from smarttouch.felt import write_sheet
from smarttouch.kernels.bank import KernelBank
from smarttouch.perception import Perception
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.running.step import StepResult
from smarttouch.texture.texture import Texture

FINEST_MM = 0.1
"""Finest dot of the picture."""
_LONGEST_SIDE = 3000


class FeltMap:
    """Delivered pulses of a hand that moves, each where its electrode was in the world.

    Pulses of the mouse come one by one as ridges pass, so nothing is averaged:
    at every place counts the strongest answer (`Perception`) within a cell.

    Parameters
    ----------
    profile : Profile
        Array and thresholds.
    bank : KernelBank
        Its kernels and receptors.
    primaries : tuple of Primary
        Whose receptors are asked.
    texture : Texture
        What lay under the hand.

    Attributes
    ----------
    number : ndarray, (N,) uint32
        Of the sequence of each pulse, in the order in which they were delivered.
    electrode : ndarray, (N,)
    place_mm : ndarray, (N, 2)
        Of the pulse on the texture.
    answer : ndarray, (N,) float32, in [0, 1]
    """

    def __init__(
        self, profile: Profile, bank: KernelBank, primaries: tuple[Primary, ...], texture: Texture
    ) -> None:
        self._texture, self._primaries = texture, primaries
        self._perception = Perception(profile, bank, primaries)
        self._position_mm = profile.electrodes.position_mm
        self._cell_mm = profile.electrodes.cell_mm
        self._poses: dict[int, tuple[float, float]] = {}
        self._least = np.full(2, np.inf)
        self._most = np.full(2, -np.inf)
        self.number, self.electrode = np.zeros(0, np.uint32), np.zeros(0, np.intp)
        self.place_mm, self.answer = np.zeros((0, 2)), np.zeros(0, np.float32)

    def watch(self, sent: StepResult) -> None:
        """Remember where the hand was when something was felt, and how far it came."""
        pose = sent.step.input.pose
        place = (pose.x_mm, pose.y_mm)
        self._least = np.minimum(self._least, place)
        self._most = np.maximum(self._most, place)
        if sent.number is not None and sent.step.sequence.slots:
            self._poses[sent.number] = place

    def deliver(
        self,
        numbers: NDArray[np.uint32],
        width_us: NDArray[np.float32],
        current_ua: NDArray[np.int16],
    ) -> None:
        """Add delivered slots, as `Perception.answers` takes them."""
        answers = self._perception.answers(numbers, width_us, current_ua)
        known = [number for number in answers if number in self._poses]
        if not known:
            return
        values = np.array([answers[number] for number in known])
        poses = np.array([self._poses[number] for number in known])
        row, electrode = np.nonzero(values)
        self.number = np.concatenate([self.number, np.array(known, np.uint32)[row]])
        self.electrode = np.concatenate([self.electrode, electrode])
        self.place_mm = np.concatenate([self.place_mm, poses[row] + self._position_mm[electrode]])
        self.answer = np.concatenate([self.answer, values[row, electrode]])

    def picture(
        self, corner_mm: tuple[float, float], shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return the touch as ink on paper, (H, W) uint8; 255 is nothing, 0 the strongest.

        Parameters
        ----------
        corner_mm : tuple of float, mm
            Top left corner of the picture on the texture.
        shape : tuple of int
            Rows and columns.
        pixel_mm : float, mm
        """
        touch = np.zeros(shape, np.float32)
        column, row = ((self.place_mm - corner_mm) // pixel_mm).astype(np.intp).T
        on = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
        np.maximum.at(touch, (row[on], column[on]), self.answer[on])
        wide, high = (max(1, round(side / pixel_mm)) for side in self._cell_mm)
        cell = np.ones((high, wide), np.uint8)
        touch = np.asarray(cv2.dilate(touch, cell), np.float32)
        return np.asarray(np.rint(255 * (1 - np.clip(touch, 0, 1))), np.uint8)

    def save(self, path: Path) -> None:
        """Write the texture with the touch below it as one PNG.

        Raises
        ------
        SmartTouchError
            If the hand was never there, or the file cannot be written.
        """
        if not np.isfinite(self._least).all():
            message = "the hand felt nothing: there is nothing to draw"
            raise SmartTouchError(message, about="felt", problem="empty")
        half = np.abs(self._position_mm).max(axis=0) + np.array(self._cell_mm)
        corner, end = self._least - half, self._most + half
        wide_mm, high_mm = (end - corner).tolist()
        pixel_mm = max(FINEST_MM, max(wide_mm, high_mm) / _LONGEST_SIDE)
        shape = (round(high_mm / pixel_mm), round(wide_mm / pixel_mm))
        left, top = corner.tolist()
        names = " and ".join(each.name for each in self._primaries)
        rows = (
            (
                self._texture.draw(left, top, shape, pixel_mm),
                f"Under the hand: {self._texture.title}",
            ),
            (
                self.picture((left, top), shape, pixel_mm),
                f"What the skin got: {names} pulses where their electrodes were",
            ),
        )
        write_sheet(path, rows)
