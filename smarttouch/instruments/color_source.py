"""A mixture as a source of stimuli."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.imaging.array_window import reading_force_n
from smarttouch.instruments.color_mix import Mixture, Times, mix_colors, parse_places
from smarttouch.instruments.skin_trace import open_trace
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import Profile
from smarttouch.running.display import Display
from smarttouch.sources.source_contract import Stimulus, StimulusSource

LONGEST_US = 20_000
"""Longest time between stimuli without a pulse, so that a lifted finger is noticed."""


class ColorSource(StimulusSource):
    """Source of the pulses of a mixture in the course of time.

    Pulses wait if sequences take longer than foreseen, and those of several stimuli go together.
    """

    frames: int

    ended = "the end of the trace"

    def __init__(
        self, title: str, profile: Profile, mixture: Mixture, force_n: float = math.nan
    ) -> None:
        super().__init__(title)
        self.knows_force: bool = not math.isnan(force_n)
        self.duration_s: float | None = mixture.end_us / 1e6
        self.settings: Mapping[str, Any] = {"scan": "points", "mode": mixture.mode}
        self._mixture, self._force_n = mixture, force_n
        self._next = 0
        self._given_us = np.full(len(mixture.time_us), -1, np.int64)

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the stimulus that is due; None after the last one."""
        now_us = time_ns // 1000
        if now_us >= self._mixture.end_us:
            return None
        self.frames += 1
        mixture, first = self._mixture, self._next
        due_us = now_us + mixture.least_us // 2
        self._next += int(np.searchsorted(mixture.time_us[first:], due_us, side="right"))
        self._given_us[first : self._next] = now_us
        drive = mixture.drive[first : self._next].max(axis=0, initial=0.0)
        if mixture.vibrated and first == self._next > 0:
            # The vibrator goes on with its last amplitude.
            drive[Afferent.PC] = mixture.drive[first - 1, Afferent.PC]
        more = self._next < len(mixture.time_us)
        wait_us = int(mixture.time_us[self._next] if more else mixture.end_us) - now_us
        parts = max(1, min(-(-wait_us // LONGEST_US), wait_us // mixture.least_us))
        period_us = max(mixture.least_us, wait_us // parts)
        activation, number = mixture.at_sites(drive), self.frames - 1
        return Stimulus(activation, time_ns, self._force_n, period_us, number=number)

    def error_us(self, afferent: Afferent) -> Times:
        """Return the delay of each requested pulse of a class, (K,) µs."""
        mixture = self._mixture
        given_us: NDArray[np.int64] = self._given_us[mixture.carried[afferent]]
        return (given_us - mixture.ideal_us[afferent])[given_us >= 0]


def notes(mixture: Mixture) -> list[str]:
    """Return warnings about a mixture, a sentence each."""
    said = []
    if mixture.left_out:
        names = " and ".join(each.name for each in mixture.left_out)
        said.append(f"{names} would answer too, and this board cannot drive it here: left out")
    for afferent, ideal_us in mixture.ideal_us.items():
        spikes = len(mixture.answers[afferent].spike_s)
        if afferent is not Afferent.PC and len(ideal_us) < 0.9 * spikes:
            said.append(
                f"{afferent.name} gets {len(ideal_us)} of {spikes} pulses: a sequence for "
                f"{len(mixture.sites)} sites takes {mixture.least_us / 1000:.1f} ms, choose fewer"
            )
    return said


def open_vibration(
    rest: str,
    profile: Profile,
    *,
    sites: str | None = None,
    seconds: float = 2.0,
    seed: int = 0,
    display: Display | None = None,
    vibrated: bool = False,
) -> ColorSource:
    """Open ``vibration:SPEC`` or ``vibration:CSV``: what `open_trace` takes, mixed for each class.

    Each class pulses as it would answer the vibration, at ``sites`` (27,28,35-36 or all). The
    display's board decides what can be mixed; without one, any board can. If ``vibrated``, a
    mechanical vibrator drives PC.
    """
    trace = open_trace(rest, seconds, seed)
    bank, places = load_bank(profile), parse_places(profile, sites)
    timing = None if display is None else display.board.driver.timing
    mixture = mix_colors(trace, profile, bank, places, timing, vibrated)
    source = ColorSource(trace.title, profile, mixture, reading_force_n(profile))
    source.notes += notes(mixture)
    if mixture.pulses(Afferent.PC):
        most = bank.off_target[Afferent.PC].max()
        source.notes.append(
            f"PC pulses reach another class up to {most:.1f} times as strongly as PC: current "
            "cannot drive PC alone"
        )
    return source
