"""Conversion of frames to tactile images: ink is detected and averaged under each electrode."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import Frame, TactileImage
from smarttouch.imaging.sensor_registration import Registration
from smarttouch.profile import Profile

LEAST_CONTRAST = 0.115  # smallest contrast of print, relative to white paper
LEAST_GRAINS = 4.0  # smallest contrast of print, relative to the contrast of the paper's grain
PALE = 0.3  # a spot with at least this contrast, relative to white paper, is never paper grain
BLURRED = 0.3
"""A pixel is ink only if its contrast, relative to white paper, is above this limit. In a frame
whose largest contrast is below 0.5, the limit is 0.6 times this largest contrast instead."""
GREY_GUARD = 0.41  # a frame is noise if a larger share of its pixels is between paper and ink
BLACK = 0.2  # a wide area darker than this, relative to white, is print; a desk is brighter
WHITE_DECAY_PER_S = 0.3  # decay rate of the white level, so slow that black headlines stay black
_CLASSES, _ROWS = len(Afferent), {mode: mode.afferents[0] for mode in Mode}
_SAMPLES = 32  # rows and columns of the sample from which levels are estimated


class Binarizer:
    """Binarizer, which separates ink from paper in successive frames of one shape.

    A dark area is ink if it is black, or if it is narrower than half the frame. Other dark areas
    are shadows or a desk, and count as paper. The threshold is halfway between the levels of paper
    and ink; in a blurred frame it is darker. A frame with low contrast has no ink. A frame with
    many pixels between paper and ink is noise, and has no ink.
    """

    def __init__(self, shape: tuple[int, int], light_on_dark: bool = False) -> None:
        self._light_on_dark = light_on_dark
        down, across = (max(1, side // _SAMPLES) for side in shape)
        self._sample = np.s_[::down, ::across]
        self._window = np.ones((shape[0] // down // 2 | 1, shape[1] // across // 2 | 1), np.uint8)
        self._white = 0.0
        self._time_ns = 0

    def ink(self, image: NDArray[np.uint8], time_ns: int, touching: bool) -> NDArray[np.uint8]:
        """Return a mask, (H, W) uint8, 255 for ink.

        If not ``touching``, the white level is estimated from this frame alone.
        """
        image = ~image if self._light_on_dark else image
        sample = np.ascontiguousarray(cv2.blur(image, (3, 3))[self._sample])
        elapsed_s, self._time_ns = max(0, time_ns - self._time_ns) / 1e9, time_ns
        floor = self._white * math.exp(-WHITE_DECAY_PER_S * elapsed_s) if touching else 0.0
        paper = cv2.morphologyEx(sample, cv2.MORPH_CLOSE, self._window)
        bright = np.bincount(sample.ravel()).cumsum().searchsorted(0.95 * sample.size, "right")
        white = self._white = max(float(bright), floor)
        paper[paper < BLACK * white] = round(white)
        depth = cv2.subtract(paper, sample)
        pixels, places = np.bincount(depth.ravel()), (0.3 * depth.size, 0.98 * depth.size)
        grain, deep = pixels.cumsum().searchsorted(places, "right").tolist()
        grey = int(np.add.reduce(pixels[round(0.3 * deep) : round(0.7 * deep)]))
        is_grain = deep < min(LEAST_GRAINS * grain, PALE * white)
        if deep < LEAST_CONTRAST * white or is_grain or grey > GREY_GUARD * depth.size:
            return np.zeros_like(image)
        limit = max(0.5 * deep, min(BLURRED * white, 0.6 * deep))
        below = cv2.subtract(cv2.resize(paper, image.shape[::-1]), image)
        return np.asarray(cv2.threshold(below, limit, 255, cv2.THRESH_BINARY)[1], np.uint8)


ADAPTATION_S = 0.04
"""Time constant of adaptation to constant ink. Our choice: longer than the period of RA pulses, and
so short that, at reading speed, no stroke smears over the next letter."""
LEAVING = 0.4
"""Activation of RA where ink disappears, relative to where ink appears. RA responds less to the end
of a touch. With a value of 1, the previous stroke would be felt beside the present stroke."""
FAINTEST_CHANGE = 0.15  # smallest change of ink that exceeds sensor noise


class NaturalDrive:
    """Filter that splits ink into changes, for RA, and a sustained part, for SAI.

    A low-pass filter follows the ink at each electrode. The change is the ink minus the filtered
    value. The sustained part is the smaller of ink and filtered value. When the finger lands,
    `last_ns` is None, and all ink counts as change.
    """

    def __init__(self, electrodes: int) -> None:
        self._slow = np.zeros(electrodes, np.float32)
        self.last_ns: int | None = None

    def drive(
        self,
        activation: NDArray[np.float32],
        ink: NDArray[np.float32],
        time_ns: int,
        touching: bool,
    ) -> None:
        """Set the rows RA and SAI of ``activation``, (3, E), from ink, (E,). If ``touching`` is
        false, set only the row RA, as if all ink had just appeared."""
        if self.last_ns is None or not touching:
            self._slow[:] = 0
        change, sustained = activation[Afferent.RA], activation[Afferent.SAI]
        np.subtract(ink, self._slow, out=change)
        if self.last_ns is not None and touching:
            elapsed_s = max(0, time_ns - self.last_ns) / 1e9
            np.minimum(ink, self._slow, out=sustained)
            sustained[sustained < FAINTEST_CHANGE] = 0
            self._slow += change * np.float32(1 - math.exp(-elapsed_s / ADAPTATION_S))
        self.last_ns = time_ns if touching else None
        change[change < 0] *= -LEAVING
        change -= FAINTEST_CHANGE
        change *= 1 / (1 - FAINTEST_CHANGE)
        # For small arrays this is faster than np.clip.
        np.maximum(change, 0, out=change)
        np.minimum(change, 1, out=change)


@dataclass(frozen=True)
class Tone:
    """Tone curve from ink under an electrode to activation."""

    faintest: float = 0.15  # share of ink in a cell above which the electrode is active
    # share of ink in a cell for full activation; if equal to `faintest`, activation is 0 or 1
    fullest: float = 0.5
    prepared: bool = False  # whether frames show ink on pure white, so that no threshold is needed


class TactileMapper:
    """Mapper of frames to tactile images, for a profile's array and optics."""

    def __init__(
        self, profile: Profile, light_on_dark: bool = False, tone: Tone | None = None
    ) -> None:
        self._profile, self._light_on_dark = profile, light_on_dark
        self._tone = tone = tone or Tone()
        # For small arrays, np.minimum with bounds as arrays is faster than with floats.
        self._faintest = np.array(tone.faintest, np.float32)
        steepness = 1 / (tone.fullest - tone.faintest) if tone.fullest > tone.faintest else math.inf
        self._steepness, self._none, self._full = np.array((steepness, 0, 1), np.float32)[:, None]
        self._natural = NaturalDrive(len(profile.electrodes))
        self._prepare((profile.optics.sensor_rows, profile.optics.sensor_columns))

    def _prepare(self, shape: tuple[int, int]) -> None:
        profile = self._profile
        self._registration = Registration(profile.electrodes, profile.optics, shape)
        self._binarizer = Binarizer(self._registration.working_shape, self._light_on_dark)
        self._inverted = np.empty(self._registration.working_shape, np.uint8)

    def map(self, frame: Frame, mode: Mode) -> TactileImage:
        """Return the tactile image of a frame. Rows of classes that the mode does not use are zero.

        The tone curve converts the share of ink in an electrode's cell to activation. Raises
        ScheduleError if ``mode`` is COLOR, because this mode takes stimuli, not frames.
        """
        if mode is Mode.COLOR:
            raise ScheduleError(
                "mode color takes stimuli, but this source delivers images: choose mode RA"
            )
        if frame.image.shape != self._registration.frame_shape:
            self._prepare((frame.image.shape[0], frame.image.shape[1]))
        touching = frame.force_n >= self._profile.force.contact_n
        reduced, registration = frame.image, self._registration
        if registration.working_shape != registration.frame_shape:
            reduced = registration.reduce(reduced)
        if self._tone.prepared:
            inked = np.asarray(cv2.bitwise_not(reduced, dst=self._inverted), np.uint8)
        else:
            inked = self._binarizer.ink(reduced, frame.time_ns, touching)
        # Add row by row, so that results are bitwise equal on all machines.
        pixel, share, self._inked = *registration.apertures, inked
        ink: NDArray[np.float32] = np.add.reduce(inked.reshape(-1).take(pixel) * share, axis=0)
        activation = np.zeros((_CLASSES, len(ink)), np.float32)
        if self._tone.fullest > self._tone.faintest:
            ink -= self._faintest
            ink *= self._steepness
            np.maximum(ink, self._none, out=ink)
            np.minimum(ink, self._full, out=ink)
        else:
            # The tolerance covers rounding errors of the sum in single precision.
            np.greater_equal(ink, self._tone.faintest - 1e-4, out=ink, casting="unsafe")
        if mode is Mode.NATURAL:
            self._natural.drive(activation, ink, frame.time_ns, touching)
        else:
            self._natural.last_ns = None
            activation[_ROWS[mode]] = ink
        return TactileImage(activation, frame.time_ns, frame.force_n, frame.period_us)
