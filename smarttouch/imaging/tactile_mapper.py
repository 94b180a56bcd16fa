"""A frame becomes a tactile image: binarized or natural, averaged under every electrode."""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.imaging.registration import Registration
from smarttouch.profile import Profile
from smarttouch.sources.source_contract import Frame

CONTRAST_GUARD = 45.0  # least contrast of print: grey levels of its darkest part below the white
GREY_GUARD = 0.41  # largest part of intermediate grey levels in print; more of them are noise
INK_LEVEL = 0.7  # part of the white below which is ink
WHITE_DECAY_PER_S = 0.8
"""Rate at which the tracked white may fall: slow enough to cross a black headline."""
GREY_PRINT = 0.55
"""Part of the white above which the darkest is grey print, or a shadow, and no black."""
FAINT_PART = 0.11  # least contrast of faint print, of the white
FAINT_GRAINS = 4.0  # least contrast of faint print, in the usual depth of the paper's grain
_FAINT_RANKS = np.array([0.5, 0.97])
"""Parts of a patch of faint print that are no deeper than grain, and than its ink."""
_WINDOW = 4  # windows of paper across a patch: strokes of text are narrower
AREA_PART = 0.5
"""Part of the patch across which an area is dark that is wider than any usual stroke."""
BLACK_AREA = 0.2
"""Part of the white above which such an area is a table, a picture or a deep shadow, no ink."""
_MUCH = 0.25  # dark part of a patch from which it is searched for such areas
_BESIDE = 2  # samples around them that are blurred
_SAMPLES = 32  # rows and columns of the sample for the guards


class Binarizer:
    """Separates ink from paper, frame after frame of one shape.

    A threshold taken from each frame by itself (Otsu's) must call something ink even on blank
    paper. Here the white of the paper is tracked from frame to frame, ink is what is darker than a
    fixed part of it, and two guards keep the whole patch silent: the darkest part must differ from
    the white, and most of the patch must be one or the other; print below that contrast must stand
    out from the grain of the paper beside it. Areas wider than strokes that are not black are no
    ink, but what a sheet lies on. Seen through a 5 mm patch, 1 in 100 places of a photographed page
    has more than 0.37 of its area in between; dense noise of any grain has 0.43 and more.
    """

    def __init__(self, shape: tuple[int, int], light_on_dark: bool = False) -> None:
        self._inverted = np.empty(shape, np.uint8) if light_on_dark else None
        self._smooth = np.empty(shape, np.uint8)
        self._ink = np.empty(shape, np.uint8)
        down, across = (max(1, side // _SAMPLES) for side in shape)
        self._sample = self._smooth[::down, ::across]
        side = max(3, min(self._sample.shape) // _WINDOW) | 1
        self._window = np.ones((side, side), np.uint8)
        area = max(3, round(AREA_PART * min(self._sample.shape))) | 1
        self._area = np.ones((area, area), np.uint8)
        self._around = np.ones((area + 2 * _BESIDE, area + 2 * _BESIDE), np.uint8)
        self._levels = np.empty(self._sample.shape, np.intp)
        count = self._sample.size
        # Of the darkest and of the brightest.
        self._ranks = np.array([int(0.02 * count), int(0.95 * count)])
        self._white = self._paper = 0.0
        self._time_ns = 0

    def ink(self, image: NDArray[np.uint8], time_ns: int, touching: bool) -> NDArray[np.uint8]:
        """Return 255 where an image, (H, W), has ink, else 0; overwritten by the next call.

        A lifted finger may land anywhere: its white is that of the frame.
        """
        if self._inverted is not None:
            image = np.asarray(cv2.bitwise_not(image, dst=self._inverted), np.uint8)
        smooth = self._smooth
        cv2.blur(image, (3, 3), dst=smooth)
        # Counts of all that is no brighter: quicker than sorting, and as good.
        np.copyto(self._levels, self._sample)
        counts = np.bincount(self._levels.reshape(-1), minlength=256).cumsum()
        dark, bright = counts.searchsorted(self._ranks, "right").tolist()
        elapsed_s = max(0, time_ns - self._time_ns) / 1e9
        self._time_ns = time_ns
        floor = self._white * math.exp(-WHITE_DECAY_PER_S * elapsed_s) if touching else 0.0
        white = self._white = max(bright, floor)
        if bright >= floor:
            self._paper = white
        # Those in the middle four tenths of the range.
        low = math.ceil(dark + 0.3 * (bright - dark))
        high = math.ceil(dark + 0.7 * (bright - dark))
        count = counts.item
        between = (count(high - 1) if high else 0) - (count(low - 1) if low else 0)
        if white - dark < CONTRAST_GUARD or dark > GREY_PRINT * white:
            return self._faint_ink(white)
        if between / count(-1) > GREY_GUARD:
            self._ink.fill(0)
            return self._ink
        cv2.threshold(smooth, INK_LEVEL * white, 255, cv2.THRESH_BINARY_INV, dst=self._ink)
        if count(int(INK_LEVEL * white)) > _MUCH * count(-1):
            self._leave_out_areas(white)
        return self._ink

    def _leave_out_areas(self, white: float) -> None:
        """Remove areas that are wider than strokes from the ink, unless they are black."""
        dark = (self._sample < INK_LEVEL * white).view(np.uint8)
        areas = np.asarray(cv2.dilate(cv2.erode(dark, self._area), self._around), np.uint8)
        if areas.any() and cv2.mean(self._sample, areas & dark)[0] > BLACK_AREA * self._paper:
            wide = cv2.resize(areas, self._ink.shape[::-1], interpolation=cv2.INTER_NEAREST)
            cv2.subtract(self._ink, wide * np.uint8(255), dst=self._ink)

    def _faint_ink(self, white: float) -> NDArray[np.uint8]:
        """Return the ink of faint print, darker than the paper: the patch without narrow spots, so
        that uneven light is no ink. The paper's own unevenness is its grain."""
        paper = cv2.morphologyEx(self._sample, cv2.MORPH_CLOSE, self._window)
        depths = np.bincount(cv2.subtract(paper, self._sample).reshape(-1), minlength=256).cumsum()
        grain, deep = depths.searchsorted(depths[-1] * _FAINT_RANKS, "right").tolist()
        if deep < max(FAINT_PART * white, FAINT_GRAINS * max(grain, 1)):
            self._ink.fill(0)
            return self._ink
        wide = cv2.resize(paper, self._smooth.shape[::-1], interpolation=cv2.INTER_LINEAR)
        depth = cv2.subtract(wide, self._smooth)
        cv2.threshold(depth, deep / 2, 255, cv2.THRESH_BINARY, dst=self._ink)
        return self._ink


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
_NOTHING, _FULL = np.zeros((), np.float32), np.ones((), np.float32)


@dataclass(frozen=True)
class Tone:
    """Tone curve from ink under an electrode to activation."""

    faintest: float = FAINTEST_INK  # fraction of ink in a cell from which its electrode is active
    # fraction from which it is fully so; if `faintest`, electrodes are on or off
    fullest: float = FULLEST_INK
    prepared: bool = False  # whether frames are ink on pure white already: nothing is thresholded

    @cached_property
    def _line(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        steepness = 1 / (self.fullest - self.faintest)
        return np.array(self.faintest, np.float32), np.array(steepness, np.float32)

    def apply(self, ink: NDArray[np.float32]) -> None:
        """Turn the ink under each electrode into activation, in place."""
        if self.fullest > self.faintest:
            faintest, steepness = self._line
            ink -= faintest
            ink *= steepness
            # On a few numbers, quicker than np.clip, and than with numbers that are no arrays.
            np.maximum(ink, _NOTHING, out=ink)
            np.minimum(ink, _FULL, out=ink)
        else:
            # A cell that is just so full, but for what a sum of single precision leaves over.
            np.greater_equal(ink, self.faintest - 1e-4, out=ink, casting="unsafe")


class TactileMapper:
    """Maps frames to tactile images by a profile's array and optics."""

    def __init__(
        self, profile: Profile, light_on_dark: bool = False, tone: Tone | None = None
    ) -> None:
        self._profile = profile
        self._light_on_dark = light_on_dark
        self._tone = tone or Tone()
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
        # As `Registration.sample`, without another call a frame.
        pixel, share = registration.apertures
        ink: NDArray[np.float32] = np.add.reduce(inked.reshape(-1).take(pixel) * share, axis=0)
        activation = np.zeros((len(Afferent), len(ink)), np.float32)
        self._tone.apply(ink)
        if mode is Mode.NATURAL:
            self._natural.drive(activation, ink, frame.time_ns, touching)
        else:
            self._natural.last_ns = None
            activation[Afferent[mode.name]] = ink
        return TactileImage(activation, frame.time_ns, frame.force_n, frame.period_us)
