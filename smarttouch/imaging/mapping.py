"""Mapping of a frame to a tactile image: binarize, then average under every electrode."""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent, Mode
from smarttouch.errors import ScheduleError
from smarttouch.imaging.natural import NaturalDrive
from smarttouch.imaging.registration import Registration
from smarttouch.profile import Profile
from smarttouch.sources.frame import Frame
from smarttouch.tactile_image import TactileImage

FAINTEST_INK = 0.15
"""Part of a cell's ink below which it is not felt at all."""
FULLEST_INK = 0.5
"""Part of a cell's ink from which it is felt in full."""
CONTRAST_GUARD = 45.0
"""Least contrast of print: grey levels of its darkest part below the white."""
GREY_GUARD = 0.41
"""Largest part of intermediate grey levels in print; more of them are noise."""
INK_LEVEL = 0.7
"""Part of the white below which is ink."""
WHITE_DECAY_PER_S = 0.8
"""Rate at which the tracked white may fall: slow enough to cross a black headline."""
_SAMPLES = 32
"""Rows and columns of the sample for the guards."""
_NOTHING, _FULL = np.zeros((), np.float32), np.ones((), np.float32)


@dataclass(frozen=True)
class Tone:
    """Tone curve from ink under an electrode to activation.

    Attributes
    ----------
    faintest : float, in [0, 1]
        Part of a cell that must be ink before it is felt at all.
    fullest : float, in [0, 1]
        Part of a cell from which it is felt in full; where it is ``faintest``,
        electrodes are on or off.
    prepared : bool
        Frames are ink on pure white already: nothing is thresholded.
    """

    faintest: float = FAINTEST_INK
    fullest: float = FULLEST_INK
    prepared: bool = False

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


class Binarizer:
    """Separates ink from paper, frame after frame.

    A threshold taken from each frame by itself (Otsu's) must call something
    ink even on blank paper. Here the white of the paper is tracked from frame
    to frame, ink is what is darker than a fixed part of it, and two guards
    keep the whole patch silent: the darkest part must differ from the white,
    and most of the patch must be one or the other. Seen through a 5 mm patch,
    1 in 100 places of a photographed page has more than 0.37 of its area in
    between; dense noise of any grain has 0.43 and more.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the images to come.
    light_on_dark : bool
        Take light for ink and dark for paper.
    """

    def __init__(self, shape: tuple[int, int], light_on_dark: bool = False) -> None:
        self._inverted = np.empty(shape, np.uint8) if light_on_dark else None
        self._smooth = np.empty(shape, np.uint8)
        self._ink = np.empty(shape, np.uint8)
        down, across = (max(1, side // _SAMPLES) for side in shape)
        self._sample = self._smooth[::down, ::across]
        self._levels = np.empty(self._sample.shape, np.intp)
        count = self._sample.size
        # Of the darkest and of the brightest.
        self._ranks = np.array([int(0.02 * count), int(0.95 * count)])
        self._white = 0.0
        self._time_ns = 0

    def ink(self, image: NDArray[np.uint8], time_ns: int, touching: bool) -> NDArray[np.uint8]:
        """Return 255 where there is ink, 0 elsewhere; overwritten by the next call.

        Parameters
        ----------
        image : ndarray, (H, W) uint8
            Of the shape given at the start.
        time_ns : int
            Time of the frame; sets how far the white may have fallen.
        touching : bool
            A lifted finger may land anywhere: its white is taken as it comes.
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
        # Those in the middle four tenths of the range.
        low = math.ceil(dark + 0.3 * (bright - dark))
        high = math.ceil(dark + 0.7 * (bright - dark))
        between = (counts[high - 1] if high else 0) - (counts[low - 1] if low else 0)
        if white - dark < CONTRAST_GUARD or between / counts[-1] > GREY_GUARD:
            self._ink.fill(0)
            return self._ink
        cv2.threshold(smooth, INK_LEVEL * white, 255, cv2.THRESH_BINARY_INV, dst=self._ink)
        return self._ink


class TactileMapper:
    """Maps frames to tactile images.

    Parameters
    ----------
    profile : Profile
        Array and optics.
    light_on_dark : bool
        For light print on dark paper.
    tone : Tone, optional
        Tone curve from ink to activation.
    """

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

        Activation rises with the part of the electrode's cell that is ink, as
        the tone has it: graded edges carry more of a letter's shape than cells
        that are on or off.

        Raises
        ------
        ScheduleError
            If the mode is color, in which stimuli alone say what each class gets.
        """
        if mode is Mode.COLOR:
            raise ScheduleError(
                "mode color is for stimuli, and this source gives images: choose RA",
                about="mode",
                problem="impossible",
                value="color",
                allowed="RA",
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
        ink = np.asarray(registration.weights @ inked.reshape(-1), np.float32)
        activation = np.zeros((len(Afferent), len(ink)), np.float32)
        self._tone.apply(ink)
        if mode is Mode.NATURAL:
            self._natural.drive(activation, ink, frame.time_ns, touching)
        else:
            self._natural.last_ns = None
            activation[Afferent[mode.name]] = ink
        return TactileImage(activation, frame.time_ns, frame.force_n)
