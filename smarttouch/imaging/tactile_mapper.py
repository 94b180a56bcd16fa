"""A frame becomes a tactile image: binarized or natural, averaged under every electrode."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.imaging.registration import Registration
from smarttouch.profile import Profile
from smarttouch.sources.source_contract import Frame

LEAST_CONTRAST = 0.115  # of print, relative to white paper
LEAST_GRAINS, PALE = 4.0, 0.3
"""Least contrast of print in depths of the paper's grain, and contrast above which grain is low."""
BLURRED = 0.3  # contrast at which blurred ink begins, unless that is above six tenths of its own
GREY_GUARD = 0.41  # part of a frame with levels between paper and ink, above which it is noise
BLACK = 0.2  # part of the white below which areas wider than strokes are print, not a dark table
WHITE_DECAY_PER_S = 0.3  # rate at which the white may fall: it outlasts a black headline
_SAMPLES = 32  # rows and columns of the sample from which levels are taken


class Binarizer:
    """Separates ink from paper, frame after frame of one shape.

    The threshold is halfway between paper and ink, or deeper in a blurred frame. The paper is the
    frame without spots narrower than half of it, so neither a shadow nor a table is ink. Only
    black areas may be wider: they are compared with the white of the frames before. A frame stays
    silent if its contrast is low, or if many levels lie between paper and ink, as in noise.
    """

    def __init__(self, shape: tuple[int, int], light_on_dark: bool = False) -> None:
        self._light_on_dark = light_on_dark
        down, across = (max(1, side // _SAMPLES) for side in shape)
        self._sample = np.s_[::down, ::across]
        self._window = np.ones((shape[0] // down // 2 | 1, shape[1] // across // 2 | 1), np.uint8)
        self._white = 0.0
        self._time_ns = 0

    def ink(self, image: NDArray[np.uint8], time_ns: int, touching: bool) -> NDArray[np.uint8]:
        """Return 255 where an image, (H, W) uint8, has ink, else 0.

        A lifted finger may land anywhere: its white is that of the frame.
        """
        image = ~image if self._light_on_dark else image
        sample = cv2.blur(image, (3, 3))[self._sample]
        elapsed_s, self._time_ns = max(0, time_ns - self._time_ns) / 1e9, time_ns
        floor = self._white * math.exp(-WHITE_DECAY_PER_S * elapsed_s) if touching else 0.0
        paper = cv2.morphologyEx(np.ascontiguousarray(sample), cv2.MORPH_CLOSE, self._window)
        bright = np.sort(sample, axis=None)[int(0.95 * sample.size)]
        white = self._white = max(float(bright), floor)
        paper[paper < BLACK * white] = round(white)
        depth = cv2.subtract(paper, sample)
        depths = np.sort(depth, axis=None)
        grain, deep = depths[[int(0.3 * depth.size), int(0.98 * depth.size)]].tolist()
        low, high = depths.searchsorted([round(0.3 * deep), round(0.7 * deep)]).tolist()
        is_grain = deep < min(LEAST_GRAINS * grain, PALE * white)
        if deep < LEAST_CONTRAST * white or is_grain or high - low > GREY_GUARD * depth.size:
            return np.zeros_like(image)
        limit = max(0.5 * deep, min(BLURRED * white, 0.6 * deep))
        below = cv2.subtract(cv2.resize(paper, image.shape[::-1]), image)
        return np.asarray(cv2.threshold(below, limit, 255, cv2.THRESH_BINARY)[1], np.uint8)


ADAPTATION_S = 0.04
"""Time constant of the adaptation to ink that stays. Ours: longer than between two
pulses of RA, and so short that a stroke at reading speed does not smear over the next letter."""
LEAVING = 0.4
"""Drive of leaving ink, relative to arriving: RA responds less to the end of a touch. (At full
strength the stroke that has just left would be felt beside the one that is there.)"""
FAINTEST_CHANGE = 0.15  # least change above the sensor's noise


class NaturalDrive:
    """Splits a tactile image into its changes and its sustained part.

    Each electrode keeps a slow memory of its activation. What differs from it is an edge on the
    move and drives RA, on arrival and on leaving; what the memory agrees with drives SAI. After
    `last_ns` of None, as on a finger that has just landed, all is new.
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
        """Fill rows RA and SAI of zeros (3, E) from ink, (E,); without touch all ink is new."""
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
        # On a few numbers, quicker than np.clip.
        np.maximum(change, 0, out=change)
        np.minimum(change, 1, out=change)


FAINTEST_INK = 0.15  # fraction of ink in a cell below which its electrode is not active
FULLEST_INK = 0.5  # fraction of ink in a cell from which its electrode is fully active


@dataclass(frozen=True)
class Tone:
    """Tone curve from ink under an electrode to activation."""

    faintest: float = FAINTEST_INK  # fraction of ink in a cell from which its electrode is active
    # fraction from which it is fully so; if `faintest`, electrodes are on or off
    fullest: float = FULLEST_INK
    prepared: bool = False  # whether frames are ink on pure white already: nothing is thresholded


class TactileMapper:
    """Maps frames to tactile images by a profile's array and optics."""

    def __init__(
        self, profile: Profile, light_on_dark: bool = False, tone: Tone | None = None
    ) -> None:
        self._profile = profile
        self._light_on_dark = light_on_dark
        self._tone = tone = tone or Tone()
        # On a few numbers, arrays are quicker than plain numbers, and than np.clip.
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
        """Return the activation of each electrode, in the rows that a mode drives.

        Activation rises with the part of the electrode's cell that is ink, as the tone has it:
        graded edges carry more of a letter's shape than cells that are on or off. Color is a
        ScheduleError, as only stimuli have the activation of each class.
        """
        if mode is Mode.COLOR:
            raise ScheduleError(
                "mode color is for stimuli, and this source gives images: choose RA"
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
        # Row after row, so that the same frame has the same mean to the bit everywhere.
        pixel, share = registration.apertures
        ink: NDArray[np.float32] = np.add.reduce(inked.reshape(-1).take(pixel) * share, axis=0)
        activation = np.zeros((len(Afferent), len(ink)), np.float32)
        if self._tone.fullest > self._tone.faintest:
            ink -= self._faintest
            ink *= self._steepness
            np.maximum(ink, self._none, out=ink)
            np.minimum(ink, self._full, out=ink)
        else:
            # A cell that is just so full, but for what a sum of single precision leaves over.
            np.greater_equal(ink, self._tone.faintest - 1e-4, out=ink, casting="unsafe")
        if mode is Mode.NATURAL:
            self._natural.drive(activation, ink, frame.time_ns, touching)
        else:
            self._natural.last_ns = None
            activation[Afferent[mode.name]] = ink
        return TactileImage(activation, frame.time_ns, frame.force_n, frame.period_us)
