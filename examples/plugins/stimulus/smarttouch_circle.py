"""Source of a point that moves in a circle and stimulates RA: ``circle:`` or ``circle:TURNS``."""

import math

import numpy as np

import smarttouch as st

TURN_S = 1.0
PERIOD_US = 20_000


def open_circle(rest: str, profile: st.Profile) -> "CircleSource":
    """Open ``circle:`` or ``circle:TURNS``."""
    if not (rest or "1").isdecimal() or rest == "0":
        raise st.SourceError(f"circle:{rest} is not a number of turns: give 1, 2 or more")
    return CircleSource(int(rest or 2), profile)


class CircleSource(st.StimulusSource):
    """Source of RA stimuli: a point that moves around the middle of the array, in 1 s per turn.

    Parameters
    ----------
    turns : int
    profile : Profile
        Profile whose electrode positions are used.
    """

    ended = "the point has made its last turn"

    def __init__(self, turns: int, profile: st.Profile) -> None:
        super().__init__("a point in a circle")
        middle_mm = profile.electrodes.position_mm.mean(axis=0)
        self._place_mm = profile.electrodes.position_mm - middle_mm
        self._radius_mm = 0.6 * float(np.linalg.norm(self._place_mm, axis=1).max())
        self.duration_s = self._end_s = turns * TURN_S

    def read(self, time_ns: int) -> st.Stimulus | None:
        """Return the stimulus at a time since the start of the run; None after the last turn."""
        if time_ns >= self._end_s * 1e9:
            return None
        turn = 2 * math.pi * time_ns / (TURN_S * 1e9)
        point_mm = self._radius_mm * np.array([math.cos(turn), math.sin(turn)])
        away_mm = np.linalg.norm(self._place_mm - point_mm, axis=1)
        activation = np.zeros((3, len(away_mm)), np.float32)
        activation[st.Afferent.RA] = np.clip(1.5 - away_mm / 2, 0, 1)
        self.frames += 1  # number of stimuli read, which each source must count
        return st.Stimulus(activation, time_ns, math.nan, PERIOD_US, number=self.frames - 1)
