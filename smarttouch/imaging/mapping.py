"""Mapping of a frame to a tactile image: binarized, then averaged under every electrode."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent, Mode
from smarttouch.errors import ScheduleError
from smarttouch.imaging.binarize import Binarizer
from smarttouch.imaging.natural import NaturalDrive
from smarttouch.imaging.registration import Registration
from smarttouch.profile import Profile
from smarttouch.sources.frame import Frame
from smarttouch.tactile_image import TactileImage

FAINTEST_INK = 0.15
"""Fraction of ink in a cell below which its electrode is not active."""
FULLEST_INK = 0.5
"""Fraction of ink in a cell from which its electrode is fully active."""
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
                "mode color is for stimuli, and this source gives images: choose RA", about="mode"
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
