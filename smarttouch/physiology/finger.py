"""A finger under an array: the response of its afferents to a scan sequence."""

from typing import Any

from smarttouch.physiology.finger_afferents import FingerAfferents
from smarttouch.physiology.response import Feeling, feel


class Finger(FingerAfferents):
    """Afferents of one finger under the array of a profile.

    Parameters
    ----------
    profile : Profile or str
        Array and skin, or the name or file of the profile. x runs to the right, y from the
        fingertip toward the palm, z into the skin.
    seed : int
        Seed of everything that differs between fingers; the same seed is the same finger.
    anatomy : str, Path or Anatomy
        "branched", "paper", a TOML file, or the anatomy itself.

    Raises
    ------
    ProfileError
        If there is no such anatomy, or the seed is negative.
    DesignError
        If the profile's pulse width is outside the fitted range.

    Examples
    --------
    >>> import smarttouch as st
    >>> profile = st.load_profile("electric-mouse")
    >>> finger = st.Finger(profile, seed=1, anatomy="paper")
    >>> step = next(st.steps(st.open_source("text:a", profile), profile, intensity=1))
    >>> feeling = finger.feel(step)
    >>> feeling.counts.shape == finger.classes.shape
    True
    """

    def feel(self, given: Any, seed: int = 1) -> Feeling:
        """Return its response to a step, a scan sequence, or a list of them.

        Parameters
        ----------
        given : Step, StepResult, ScanSequence, or iterable of these
        seed : int
            Of the noise from pulse to pulse.
        """
        return feel(self, given, seed)
