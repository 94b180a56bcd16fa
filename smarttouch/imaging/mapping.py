"""Frame to tactile image: binarize, then average under every electrode."""

import numpy as np

from smarttouch.imaging.binarize import Binarizer
from smarttouch.imaging.natural import NaturalDrive
from smarttouch.imaging.registration import Registration
from smarttouch.imaging.tactile_image import TactileImage
from smarttouch.primary import Mode, Primary
from smarttouch.profile import Profile
from smarttouch.sensing.frame import Frame

FAINTEST_INK = 0.15
"""Part of a cell that must be ink before it is felt at all."""
FULLEST_INK = 0.5
"""Part of a cell from which it is felt in full."""


class TactileMapper:
    """Turns frames into tactile images.

    Parameters
    ----------
    profile : Profile
        Array and optics.
    light_on_dark : bool
        For light print on dark paper.
    """

    def __init__(self, profile: Profile, light_on_dark: bool = False) -> None:
        self._profile = profile
        self._light_on_dark = light_on_dark
        self._natural = NaturalDrive(len(profile.electrodes))
        self._prepare((profile.optics.sensor_rows, profile.optics.sensor_columns))

    def _prepare(self, shape: tuple[int, int]) -> None:
        profile = self._profile
        self._registration = Registration(profile.electrodes, profile.optics, shape)
        self._binarizer = Binarizer(self._registration.working_shape, self._light_on_dark)

    def map(self, frame: Frame, mode: Mode) -> TactileImage:
        """Return what each electrode should let the finger feel, in the rows that a mode drives.

        Activation rises with the part of the electrode's cell that is ink,
        from `FAINTEST_INK` to `FULLEST_INK`: graded edges carry more of a
        letter's shape than cells that are on or off.
        """
        if frame.image.shape != self._registration.frame_shape:
            self._prepare((frame.image.shape[0], frame.image.shape[1]))
        touching = frame.force_n >= self._profile.force.contact_n
        reduced = self._registration.reduce(frame.image)
        ink = self._registration.sample(self._binarizer.ink(reduced, frame.time_ns, touching))
        activation = np.zeros((len(Primary), len(ink)), np.float32)
        ink -= FAINTEST_INK
        ink *= 1 / (FULLEST_INK - FAINTEST_INK)
        np.clip(ink, 0, 1, out=ink)
        if mode is Mode.NATURAL:
            self._natural.drive(activation, ink, frame.time_ns, touching)
        else:
            self._natural.forget()
            activation[Primary[mode.name]] = ink
        return TactileImage(activation, frame.time_ns, frame.force_n)
