"""Answers of three classes, mixed into one train of stimuli.

Each class keeps its own pulses: RA and PC locked to the phase of the vibration, at every
cycle or, where cycles come faster than the board can follow, at every second, third ...;
SAI at the rate that follows pressure. A sequence carries pulses of several classes, see
`smarttouch.vibrotactile.train`.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent, Mode
from smarttouch.errors import ScheduleError
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.sources.stimulus import Stimulus
from smarttouch.stimulation.timing import ScanTiming
from smarttouch.vibrotactile.sites import chosen, disc, stimulated
from smarttouch.vibrotactile.split import Answer, split
from smarttouch.vibrotactile.trace import Trace
from smarttouch.vibrotactile.train import Times, merged, shortest_us, thinned

PC_RATE_HZ = 150.0
"""Most pulses of PC a second, so one for every second cycle at its best frequency. Ours; faster
ones were of little use to the paper's subjects in PC mode (Section III-C.1, above 100 Hz)."""
VIBRATION_US = 20_000
"""Interval of new amplitudes of vibrators. Ours."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """A train of stimuli."""

    time_us: Times  # (R,) int64, µs: when each is to be made, rising
    drive: NDArray[np.float32]  # (R, 3) float32, in [0, 1]: of each class then; 0 is no pulse
    sites: NDArray[np.intp]  # (S,): electrodes that pulse
    electrodes: int  # E
    end_us: int  # when all is over
    least_us: int  # the shortest sequence that carries pulses of all classes
    ideal_us: dict[Afferent, Times]  # (K,) int64, µs: when each pulse of a class should be
    carried: dict[Afferent, NDArray[np.intp]]  # (K,): which stimulus carries it
    left_out: tuple[Afferent, ...]  # classes that answer, but the board cannot drive
    vibrated: bool  # whether the row of PC is for vibrators, held until the next stimulus

    @property
    def mode(self) -> Mode:
        """Mode in which its stimuli are processed: of the class, where it is a single one."""
        if len(self.ideal_us) == 1 and not self.vibrated:
            return Mode[next(iter(self.ideal_us)).name]
        return Mode.COLOR

    @property
    def stimuli(self) -> list[Stimulus]:
        """All stimuli, of unknown force; each lasts until the next one."""
        periods = np.diff(self.time_us, append=self.end_us)
        return [
            Stimulus(self.at_sites(drive), 1000 * int(time), math.nan, int(period))
            for time, drive, period in zip(self.time_us, self.drive, periods, strict=True)
        ]

    def at_sites(self, drive: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the activation of each class's drive, (3,), at all sites, (3, E)."""
        activation = np.zeros((len(Afferent), self.electrodes), np.float32)
        activation[:, self.sites] = drive[:, None]
        return activation

    def error_us(self, afferent: Afferent) -> Times:
        """Return the delay of each pulse of a class, (K,) µs."""
        return self.time_us[self.carried[afferent]] - self.ideal_us[afferent]

    def pulses(self, afferent: Afferent) -> int:
        """Return the number of pulses of a class at each site."""
        return len(self.ideal_us.get(afferent, ()))


def mix_colors(
    trace: Trace,
    # its force law sets the pressure at which SAI is driven in full, its limits how fast sequences
    # may follow one another
    profile: Profile,
    bank: KernelBank,  # its kernels say which classes the board can drive
    sites: Collection[int] | None = None,  # electrodes that pulse; those of `disc` if not given
    timing: ScanTiming | None = None,  # scan timing fixed by the board
    vibrated: bool = False,  # whether mechanical vibrators do what PC is to feel
    pc_rate_hz: float = PC_RATE_HZ,  # most pulses of PC a second
) -> Mixture:
    """Return the pulses that reproduce a trace.

    Examples
    --------
    >>> from smarttouch.vibrotactile.mix import mix_colors
    >>> from smarttouch.vibrotactile.spec import open_trace
    >>> from smarttouch.kernels.bank import load_bank
    >>> from smarttouch.afferent import Afferent
    >>> from smarttouch.profile import load_profile
    >>> profile = load_profile("electric-mouse")
    >>> trace = open_trace("tone:30Hz,8um+press:0.45N", seconds=1.0)
    >>> mixture = mix_colors(trace, profile, load_bank(profile))
    >>> [mixture.pulses(each) for each in Afferent]  # RA, SAI, PC
    [27, 24, 0]
    >>> mixture.stimuli[0].activation.shape
    (3, 64)
    """
    answers = split(trace, sai_full_n=profile.force.full_n, sai_rate_hz=profile.pulse.sai_rate_hz)
    return mix(answers, trace.duration_s, profile, bank, sites, timing, vibrated, pc_rate_hz)


def mix(
    answers: Mapping[Afferent, Answer],
    duration_s: float,
    profile: Profile,
    bank: KernelBank,
    sites: Collection[int] | None = None,
    timing: ScanTiming | None = None,
    vibrated: bool = False,
    pc_rate_hz: float = PC_RATE_HZ,
) -> Mixture:
    """Return the pulses of given responses, such as those of `split`; see `mix_colors`."""
    timing = ScanTiming() if timing is None else timing
    places = disc(profile) if sites is None else chosen(profile, sites)
    pulsing, left_out = _drivable(answers, profile, bank, places, vibrated)
    shaking = vibrated and Afferent.PC in pulsing
    electrical = [each for each in pulsing if not (shaking and each is Afferent.PC)]
    least_us = shortest_us(profile, len(places) * max(1, len(electrical)), timing)
    apart_us = dict.fromkeys(Afferent, least_us)
    apart_us[Afferent.PC] = max(least_us, math.ceil(1e6 / pc_rate_hz))
    ideal = {
        each: thinned(np.rint(answers[each].spike_s * 1e6).astype(np.int64), apart_us[each])
        for each in electrical
    }
    if len(electrical) > 1 and (timing.whole_hz or timing.every_electrode or timing.in_index_order):
        raise ScheduleError(
            f"{' and '.join(each.name for each in electrical)} answer this, each at a rate of its "
            "own, and this board scans all electrodes at one: choose another board, or something "
            "that one class alone answers",
            about="classes",
        )
    trains = list(ideal.values())
    if shaking:
        step_us = max(VIBRATION_US, least_us)
        trains.append(np.arange(0, round(duration_s * 1e6), step_us))
    time_us, given = merged(trains, least_us)
    carried = dict(zip(ideal, given, strict=False))
    drive = np.zeros((len(time_us), len(Afferent)), np.float32)
    for each, which in carried.items():
        drive[which, each] = _drive_at(answers[each], ideal[each], duration_s)
    if shaking:
        drive[:, Afferent.PC] = _drive_at(answers[Afferent.PC], time_us, duration_s)
    over_us = int(time_us[-1]) + least_us if len(time_us) else 0
    return Mixture(
        time_us,
        drive,
        places,
        len(profile.electrodes),
        max(over_us, round(duration_s * 1e6)),
        least_us,
        ideal,
        carried,
        left_out,
        shaking,
    )


def _drivable(
    answers: Mapping[Afferent, Answer],
    profile: Profile,
    bank: KernelBank,
    places: NDArray[np.intp],
    vibrated: bool,
) -> tuple[list[Afferent], tuple[Afferent, ...]]:
    """Return the classes that respond and can be driven, and those that cannot."""
    made = [
        each
        for each in Afferent
        if (vibrated and each is Afferent.PC)
        or (each in bank.weights and len(stimulated(profile, each, places)))
    ]
    answering = [each for each in Afferent if len(answers[each].spike_s)]
    left_out = tuple(each for each in answering if each not in made)
    if left_out and len(left_out) == len(answering):
        raise ScheduleError(
            f"only {' and '.join(each.name for each in left_out)} would answer this, and the "
            f"board of {profile.name} drives {' and '.join(each.name for each in made)} at these "
            "sites: choose another profile, or something that others answer too",
            about="classes",
        )
    return [each for each in answering if each in made], left_out


def _drive_at(answer: Answer, time_us: Times, duration_s: float) -> NDArray[np.float32]:
    """Return the drive at some times, (K,)."""
    last = len(answer.drive) - 1
    sample = np.rint(time_us * ((last + 1) / duration_s / 1e6)).astype(np.intp)
    return np.asarray(answer.drive[np.minimum(sample, last)], np.float32)
