"""Conversion of a vibration into one train of stimuli for the three afferent classes.

RA and PC pulses are phase-locked to the vibration. If the board is too slow for a pulse in each
cycle, cycles are skipped. The rate of SAI pulses follows pressure. One scan sequence can contain
pulses of several classes.
"""

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.imaging.reading_profile import reading_force_n
from smarttouch.instruments.vibration_trace import ReceptorResponse, Trace, open_trace, split_trace
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.profile import Profile
from smarttouch.profile.profile import require_driven
from smarttouch.running.display import Display
from smarttouch.sources.source_contract import Stimulus, StimulusSource
from smarttouch.stimulation.scan_sequence import ScanTiming
from smarttouch.stimulation.slots import perceived_at


def disc(profile: Profile) -> NDArray[np.intp]:
    """Return the driven electrodes, (S,), that are at most one pitch from the array's center. If
    there is none, return the nearest."""
    electrodes = profile.electrodes
    off_mm = electrodes.position_mm[profile.driven] - electrodes.position_mm.mean(axis=0)
    away_mm = np.hypot(off_mm[:, 0], off_mm[:, 1])
    return np.asarray(profile.driven[away_mm <= max(electrodes.pitch_mm, away_mm.min()) + 1e-9])


def stimulated(profile: Profile, afferent: Afferent, sites: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the electrodes, (S',), whose pulses a person perceives at ``sites``, (S,). If the
    profile has a shift for the class, a pulse is perceived at the place of its electrode plus this
    shift (paper, Section III-B.4). A site is omitted if no driven electrode is perceived there."""
    places = perceived_at(profile, afferent)
    if places is None:
        return sites
    there = np.flatnonzero(np.isin(places, sites))
    return np.asarray(np.intersect1d(there, profile.driven))


def parse_places(profile: Profile, sites: str | None) -> NDArray[np.intp]:
    """Parse a list of electrodes: ``27,28,35-36`` or ``all``. If ``sites`` is None, return the
    electrodes that `disc` selects."""
    if sites is None:
        return disc(profile)
    if sites == "all":
        return profile.driven
    return require_driven(profile, sites, ScheduleError, "sites")


Times = NDArray[np.int64]


def shortest_us(profile: Profile, slots: int, timing: ScanTiming) -> int:
    """Return the shortest period, µs, of a sequence that has ``slots`` slots. It follows from the
    limits of the profile and from the timing of the board."""
    pulse, limits = profile.pulse, profile.limits
    within_us = max(slots * pulse.width_us / limits.duty, 1e6 / limits.rate_hz)
    return timing.shortest_period_us(
        within_us, slots, len(profile.electrodes), pulse.width_us, pulse.discharge_us
    )


def thinned(time_us: Times, least_us: int) -> Times:
    """Select from ascending times so that the selected times are ``least_us`` or more apart."""
    kept_us, free_us = [], -math.inf
    for pulse_us in time_us.tolist():
        # Times are rounded to µs, so tolerate 1 µs.
        if pulse_us >= free_us - 1:
            kept_us.append(pulse_us)
            free_us = pulse_us + least_us
    return np.array(kept_us, np.int64)


def merged(trains: list[Times], least_us: int) -> tuple[Times, list[NDArray[np.intp]]]:
    """Merge trains of pulses into sequences that start at least ``least_us`` apart.

    A train has the ascending times of its pulses, (K,) int64, µs. Two pulses of a train are at
    least (``least_us`` - 1) µs apart. A pulse joins the latest sequence if the sequence began less
    than half of ``least_us`` ago. Otherwise, the pulse starts a new sequence. Pulses move by at
    most half of ``least_us``. Return the start of each sequence and, for each train, the index of
    the sequence that each of its pulses joined.
    """
    events = sorted(
        (pulse_us, row) for row, train in enumerate(trains) for pulse_us in train.tolist()
    )
    begins: list[int] = []
    carried: list[list[int]] = [[] for _ in trains]
    joined: set[int] = set()
    for pulse_us, row in events:
        if not begins or row in joined or 2 * (pulse_us - begins[-1]) >= least_us:
            begins.append(max(pulse_us, begins[-1] + least_us) if begins else pulse_us)
            joined = set()
        joined.add(row)
        carried[row].append(len(begins) - 1)
    return np.array(begins, np.int64), [np.array(members, np.intp) for members in carried]


PC_RATE_HZ = 150.0
"""Largest rate of PC pulses (our choice). A vibration of 250 Hz gets a pulse in every second cycle.
Above 100 Hz, PC mode was of little use to the paper's subjects (Section III-C.1)."""
VIBRATION_US = 20_000  # interval between updates of a vibrator's amplitude (our choice)


@dataclass(frozen=True, eq=False)
class Mixture:
    """Train of stimuli for several afferent classes."""

    time_us: Times  # (R,) int64, µs: time of each stimulus, ascending
    drive: NDArray[np.float32]  # (R, 3) float32, in [0, 1]: drive of each class; 0 means no pulse
    sites: NDArray[np.intp]  # (S,): stimulated electrodes
    electrodes: int  # number of electrodes (E)
    end_us: int  # end of the last stimulus
    least_us: int  # shortest period of a sequence that has pulses of all classes
    ideal_us: dict[Afferent, Times]  # (K,) int64, µs: ideal time of each pulse of a class
    carried: dict[Afferent, NDArray[np.intp]]  # (K,): for each pulse, the index of its stimulus
    left_out: tuple[Afferent, ...]  # classes that would respond, but that the board cannot pulse
    vibrated: bool  # whether a mechanical vibrator stimulates PC; its amplitude follows PC drive
    answers: Mapping[Afferent, ReceptorResponse]  # response of each class to the trace

    @property
    def mode(self) -> Mode:
        """Mode of the stimuli. If all are pulses for one class, it is the mode of this class.
        Otherwise, it is the mode ``color``."""
        if len(self.ideal_us) == 1 and not self.vibrated:
            return Mode[next(iter(self.ideal_us)).name]
        return Mode.COLOR

    @property
    def stimuli(self) -> list[Stimulus]:
        """All stimuli, with unknown force (NaN). Each lasts until the next stimulus."""
        periods = np.diff(self.time_us, append=self.end_us)
        return [
            Stimulus(self.at_sites(drive), 1000 * int(time), math.nan, int(period))
            for time, drive, period in zip(self.time_us, self.drive, periods, strict=True)
        ]

    def at_sites(self, drive: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the activation, (3, E): ``drive``, (3,), at each site, and zero elsewhere."""
        activation = np.zeros((len(Afferent), self.electrodes), np.float32)
        activation[:, self.sites] = drive[:, None]
        return activation

    def pulses(self, afferent: Afferent) -> int:
        """Return the number of pulses of a class at each site."""
        return len(self.ideal_us.get(afferent, ()))


def mix_colors(
    trace: Trace,
    # SAI drive is full at `force.full_n`. The shortest period of a sequence follows from `limits`.
    profile: Profile,
    bank: KernelBank,  # kernels; a class without kernels cannot be stimulated
    sites: Collection[int] | None = None,  # stimulated electrodes; by default those of `disc`
    timing: ScanTiming | None = None,  # timing of the board's scans
    vibrated: bool = False,  # whether a mechanical vibrator stimulates PC
) -> Mixture:
    """Return the pulses that reproduce a trace of vibration and pressure.

    Examples
    --------
    >>> import smarttouch as st
    >>> from smarttouch.instruments.vibration_stimuli import mix_colors
    >>> from smarttouch.instruments.vibration_trace import open_trace
    >>> from smarttouch.kernels.bank import load_bank
    >>> profile = st.load_profile("electric-mouse")
    >>> trace = open_trace("tone:30Hz,8um+press:0.45N", seconds=1.0)
    >>> mixture = mix_colors(trace, profile, load_bank(profile))
    >>> [mixture.pulses(each) for each in st.Afferent]  # RA, SAI, PC
    [27, 24, 0]
    """
    timing = timing or ScanTiming()
    answers = split_trace(trace, profile.force.full_n, profile.pulse.sai_rate_hz)
    places = (
        disc(profile) if sites is None else require_driven(profile, sites, ScheduleError, "site")
    )
    pulsing, left_out = _drivable(answers, profile, bank, places, vibrated)
    shaking = vibrated and Afferent.PC in pulsing
    electrical = [afferent for afferent in pulsing if not (shaking and afferent is Afferent.PC)]
    if len(electrical) > 1 and (timing.whole_hz or timing.every_electrode or timing.in_index_order):
        raise ScheduleError(
            f"{_names(electrical)} respond to this vibration, each at a different rate, "
            "but this board scans all electrodes at one rate: choose another board, or "
            "a vibration to which only one class responds"
        )
    least_us = shortest_us(profile, len(places) * max(1, len(electrical)), timing)
    ideal = {}
    for afferent in electrical:
        apart_us = max(least_us, math.ceil(1e6 / PC_RATE_HZ) if afferent is Afferent.PC else 0)
        ideal[afferent] = thinned(
            np.rint(answers[afferent].spike_s * 1e6).astype(np.int64), apart_us
        )
    lasts_us = round(trace.duration_s * 1e6)
    vibration = [np.arange(0, lasts_us, max(VIBRATION_US, least_us))] if shaking else []
    time_us, stimuli = merged([*ideal.values(), *vibration], least_us)
    carried = dict(zip(ideal, stimuli, strict=False))
    drive = np.zeros((len(time_us), len(Afferent)), np.float32)
    for begin_us, which in carried.items():
        drive[which, begin_us] = _drive_at(answers[begin_us], ideal[begin_us], trace.duration_s)
    if shaking:
        drive[:, Afferent.PC] = _drive_at(answers[Afferent.PC], time_us, trace.duration_s)
    end_us = max(int(time_us[-1]) + least_us if len(time_us) else 0, lasts_us)
    return Mixture(
        time_us, drive, places, len(profile.electrodes), end_us, least_us, ideal, carried, left_out,
        shaking, answers,
    )  # fmt: skip


def _names(afferents: Iterable[Afferent]) -> str:
    return " and ".join(afferent.name for afferent in afferents)


def _drivable(
    answers: Mapping[Afferent, ReceptorResponse],
    profile: Profile,
    bank: KernelBank,
    places: NDArray[np.intp],
    vibrated: bool,
) -> tuple[list[Afferent], tuple[Afferent, ...]]:
    """Split the responding classes into those that the board can stimulate and all others."""
    drivable = [
        afferent
        for afferent in Afferent
        if (vibrated and afferent is Afferent.PC)
        or (afferent in bank.weights and len(stimulated(profile, afferent, places)))
    ]
    answering = [afferent for afferent in Afferent if len(answers[afferent].spike_s)]
    left_out = tuple(afferent for afferent in answering if afferent not in drivable)
    if left_out and len(left_out) == len(answering):
        raise ScheduleError(
            f"only {_names(left_out)} would respond to this vibration, but the "
            f"board of {profile.name} stimulates only {_names(drivable)} at these "
            "sites: choose another profile, or a vibration to which other classes respond"
        )
    return [afferent for afferent in answering if afferent in drivable], left_out


def _drive_at(answer: ReceptorResponse, time_us: Times, duration_s: float) -> NDArray[np.float32]:
    """Return the drive of a class at the given times, (K,)."""
    last = len(answer.drive) - 1
    sample = np.rint(time_us * ((last + 1) / duration_s / 1e6)).astype(np.intp)
    return np.asarray(answer.drive[np.minimum(sample, last)], np.float32)


LONGEST_US = 20_000
"""Longest time, µs, between stimuli. The run reads the force at each stimulus. With a longer time,
it would notice later that the finger has been lifted."""


class ColorSource(StimulusSource):
    """Source that plays the stimuli of a mixture. Stimuli that are due together are merged."""

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

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the stimulus that is due; None after the last one."""
        now_us = time_ns // 1000
        if now_us >= self._mixture.end_us:
            return None
        self.frames += 1
        mixture, first = self._mixture, self._next
        due_us = now_us + mixture.least_us // 2
        self._next += int(np.searchsorted(mixture.time_us[first:], due_us, side="right"))
        drive = mixture.drive[first : self._next].max(axis=0, initial=0.0)
        if mixture.vibrated and first == self._next > 0:
            # No stimulus is due, so the vibrator keeps its last amplitude.
            drive[Afferent.PC] = mixture.drive[first - 1, Afferent.PC]
        more = self._next < len(mixture.time_us)
        wait_us = int(mixture.time_us[self._next] if more else mixture.end_us) - now_us
        parts = max(1, min(-(-wait_us // LONGEST_US), wait_us // mixture.least_us))
        period_us = max(mixture.least_us, wait_us // parts)
        activation, number = mixture.at_sites(drive), self.frames - 1
        return Stimulus(activation, time_ns, self._force_n, period_us, number=number)


def notes(mixture: Mixture) -> list[str]:
    """Return warnings about a mixture, one sentence each."""
    sentences = []
    if mixture.left_out:
        names = _names(mixture.left_out)
        sentences.append(
            f"no pulses for {names}: {names} would respond to this vibration, but this board "
            f"cannot stimulate {names} at these sites"
        )
    for afferent, ideal_us in mixture.ideal_us.items():
        spikes = len(mixture.answers[afferent].spike_s)
        if afferent is not Afferent.PC and len(ideal_us) < 0.9 * spikes:
            sentences.append(
                f"{afferent.name} gets {len(ideal_us)} of {spikes} pulses: a sequence for "
                f"{len(mixture.sites)} sites takes {mixture.least_us / 1000:.1f} ms; choose fewer "
                "sites"
            )
    return sentences


def open_vibration(
    rest: str,
    profile: Profile,
    *,
    sites: str | None = None,
    seconds: float = 2.0,
    display: Display | None = None,
    vibrated: bool = False,
) -> ColorSource:
    """Open ``vibration:TRACE``. TRACE is a line of text or the path of a CSV file, as for
    `open_trace`. ``sites`` lists the electrodes that pulse, as in ``27,28,35-36`` or ``all``. They
    pulse for a class when the receptors of this class would fire. If ``display`` is given, the
    stimuli fit the timing of its board. If ``vibrated``, a mechanical vibrator stimulates PC."""
    trace = open_trace(rest, seconds)
    bank, places = load_bank(profile), parse_places(profile, sites)
    timing = None if display is None else display.board.driver.timing
    mixture = mix_colors(trace, profile, bank, places, timing, vibrated)
    source = ColorSource(trace.title, profile, mixture, reading_force_n(profile))
    source.notes += notes(mixture)
    if mixture.pulses(Afferent.PC):
        worst_other = bank.off_target[Afferent.PC].max()
        source.notes.append(
            f"pulses for PC stimulate another class up to {worst_other:.1f} times as strongly as "
            "PC: electrodes cannot stimulate PC alone"
        )
    return source
