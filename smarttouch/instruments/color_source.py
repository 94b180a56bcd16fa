"""A mixture as a source of stimuli, and the report, crosstalk and picture of what it sends.

PC lies below RA and SAI, and no current from the skin reaches it alone (paper, Section II-D;
the best kernels that there are do more to another class than to PC, `smarttouch.kernels`).
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.instruments.color_mix import Mixture, Times, stimulated
from smarttouch.instruments.receptor_responses import ReceptorResponse, shares
from smarttouch.instruments.skin_trace import Trace
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.running.listener import Listener
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Stimulus, StimulusSource
from smarttouch.views.class_figures import ClassRow, color_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class PacinianCrosstalk:
    """Crosstalk of PC pulses into other classes."""

    # (S,) float64: activating function at the worst node of another class over that at PC's, by
    # electrode
    times: NDArray[np.float64]
    worst: tuple[Afferent, ...]  # (S,): class of that node

    @property
    def mean(self) -> float:
        """Mean of ``times`` over the electrodes."""
        return float(self.times.mean())

    def __str__(self) -> str:
        names = " or ".join(each.name for each in Afferent if each in self.worst)
        return (
            f"PC pulses also reach {names}, {self.mean:.1f} times as strongly as PC (mean of "
            f"{len(self.times)} electrodes, at most {self.times.max():.1f}): current cannot drive "
            "PC alone"
        )


def pacinian_crosstalk(
    profile: Profile, bank: KernelBank, sites: NDArray[np.intp]
) -> PacinianCrosstalk | None:
    """Return the crosstalk of PC stimulation at sites, (S,); None where it cannot be driven."""
    places = stimulated(profile, Afferent.PC, sites)
    if Afferent.PC not in bank.weights or not len(places):
        return None
    worst = tuple(Afferent(int(each)) for each in bank.worst_class[Afferent.PC][places])
    return PacinianCrosstalk(np.asarray(bank.off_target[Afferent.PC][places], np.float64), worst)


LONGEST_US = 20_000
"""Longest time between stimuli without a pulse, so that a lifted finger is noticed."""


class ColorSource(StimulusSource, Listener):
    """Source of the pulses of a mixture in the course of time.

    Pulses wait if sequences take longer than foreseen, and those of several stimuli go together.
    """

    ended = "the end of the trace"

    def __init__(
        self, title: str, profile: Profile, mixture: Mixture, force_n: float = math.nan
    ) -> None:
        super().__init__(title)
        self.knows_force = not math.isnan(force_n)
        self.duration_s = mixture.end_us / 1e6
        self._mixture, self._force_n = mixture, force_n
        self._next = 0
        self._given_us = np.full(len(mixture.time_us), -1, np.int64)
        self._count = Counter[Afferent]()

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
            # Vibrators go on with their last amplitudes.
            drive[Afferent.PC] = mixture.drive[first - 1, Afferent.PC]
        more = self._next < len(mixture.time_us)
        wait_us = int(mixture.time_us[self._next] if more else mixture.end_us) - now_us
        parts = max(1, min(-(-wait_us // LONGEST_US), wait_us // mixture.least_us))
        period_us = max(mixture.least_us, wait_us // parts)
        activation, number = mixture.at_sites(drive), self.frames - 1
        return Stimulus(activation, time_ns, self._force_n, period_us, number=number)

    def step(self, result: StepResult) -> None:
        """Count the pulses sent in a step."""
        if result.number is not None and result.step.sequence.intensity > 0:
            active = np.flatnonzero(result.step.tactile.activation.any(axis=1))
            self._count.update(Afferent(each) for each in active.tolist())

    def sent(self, afferent: Afferent) -> int:
        """Return the number of pulses of a class sent to each site so far."""
        return self._count[afferent]

    def error_us(self, afferent: Afferent) -> Times:
        """Return the delay of each requested pulse of a class, (K,) µs."""
        mixture = self._mixture
        given_us: NDArray[np.int64] = self._given_us[mixture.carried[afferent]]
        return (given_us - mixture.ideal_us[afferent])[given_us >= 0]


@dataclass(frozen=True)
class Answered:
    """Response of one class: means over the trace; of the rate, while it fires."""

    mean_drive: float
    peak_drive: float
    rate_hz: float
    share: float


@dataclass(frozen=True)
class SentOut:
    """Output to one class: pulses at each site, and their delays."""

    pulses: int
    planned: int
    rate_hz: float
    off_p50_us: float
    off_max_us: float


def answered(answers: Mapping[Afferent, ReceptorResponse]) -> dict[Afferent, Answered]:
    """Return the response of each class."""
    part = shares(answers)
    return {
        afferent: Answered(each.mean_drive, each.peak_drive, each.mean_rate_hz, part[afferent])
        for afferent, each in answers.items()
    }


def sent_out(mixture: Mixture, source: ColorSource) -> dict[Afferent, SentOut]:
    """Return the output to each class that had pulses."""
    rows = {}
    for afferent, ideal_us in mixture.ideal_us.items():
        off_us = np.abs(source.error_us(afferent))
        median, most = (np.median(off_us), off_us.max()) if len(off_us) else (0.0, 0.0)
        lasts_s = float(np.ptp(ideal_us)) / 1e6
        rows[afferent] = SentOut(
            source.sent(afferent),
            len(ideal_us),
            (len(ideal_us) - 1) / lasts_s if lasts_s else 0.0,
            float(median),
            float(most),
        )
    return rows


def answer_rows(answers: Mapping[Afferent, ReceptorResponse]) -> list[tuple[str, ...]]:
    """Return rows of class, mean and peak drive, rate and share, in words."""
    return [
        (
            afferent.name,
            f"{row.mean_drive:.2f}",
            f"{row.peak_drive:.2f}",
            _fires_at(row),
            f"{row.share:.0%}",
        )
        for afferent, row in answered(answers).items()
    ]


def mixture_rows(
    answers: Mapping[Afferent, ReceptorResponse], mixture: Mixture, source: ColorSource
) -> list[tuple[str, ...]]:
    """Return rows of class, drive, share and rate, and of pulses, their rate and lateness."""
    sent = sent_out(mixture, source)
    rows = []
    for afferent, row in answered(answers).items():
        cells = ["–", "–", "–"]
        if afferent in sent:
            out = sent[afferent]
            off = f"{out.off_p50_us / 1000:.2f} / {out.off_max_us / 1000:.2f}"
            cells = [f"{out.pulses}", f"{out.rate_hz:.1f} Hz", off]
        elif mixture.vibrated and row.share:
            cells[0] = "vibrated"
        drive, share = f"{row.mean_drive:.2f}", f"{row.share:.0%}"
        rows.append((afferent.name, drive, share, _fires_at(row), *cells))
    return rows


def _fires_at(row: Answered) -> str:
    return f"{row.rate_hz:.1f} Hz" if row.rate_hz else "–"


def notes(mixture: Mixture, answers: Mapping[Afferent, ReceptorResponse]) -> list[str]:
    """Return warnings about a mixture, a sentence each."""
    said = []
    if mixture.left_out:
        names = " and ".join(each.name for each in mixture.left_out)
        said.append(f"{names} would answer too, and this board cannot drive it here: left out")
    for afferent, ideal_us in mixture.ideal_us.items():
        spikes = len(answers[afferent].spike_s)
        if afferent is not Afferent.PC and len(ideal_us) < 0.9 * spikes:
            said.append(
                f"{afferent.name} gets {len(ideal_us)} of {spikes} pulses: a sequence for "
                f"{len(mixture.sites)} sites takes {mixture.least_us / 1000:.1f} ms, choose fewer"
            )
    return said


def as_figures(
    answers: Mapping[Afferent, ReceptorResponse],
    mixture: Mixture | None = None,
    source: ColorSource | None = None,
    crosstalk: PacinianCrosstalk | None = None,
) -> dict[str, object]:
    """Return the whole report for a JSON file."""
    classes: dict[str, dict[str, object]] = {
        afferent.name: {"answered": asdict(each)} for afferent, each in answered(answers).items()
    }
    figures: dict[str, object] = {"classes": classes}
    if mixture is not None and source is not None:
        for afferent, row in sent_out(mixture, source).items():
            classes[afferent.name]["sent"] = asdict(row)
        figures |= {
            "sites": mixture.sites.tolist(),
            "vibrated": mixture.vibrated,
            "left_out": [each.name for each in mixture.left_out],
            "shortest_sequence_us": mixture.least_us,
        }
    if crosstalk is not None:
        figures["pc_also_reaches"] = {
            "classes": sorted({each.name for each in crosstalk.worst}),
            "mean_times": crosstalk.mean,
            "worst_times": float(crosstalk.times.max()),
        }
    return figures


def draw_mixture(
    trace: Trace, answers: Mapping[Afferent, ReceptorResponse], mixture: Mixture | None = None
) -> "Figure":
    """Draw a vibration, what each class answers, and the pulses if there are any."""
    rows = {}
    for afferent, answer in answers.items():
        which = np.empty(0, np.intp)
        shaken = mixture is not None and mixture.vibrated and afferent is Afferent.PC
        if mixture is not None:
            everything = np.arange(len(mixture.time_us))
            which = everything if shaken else mixture.carried.get(afferent, which)
            pulse_s, drive = mixture.time_us[which] / 1e6, mixture.drive[which, afferent]
        else:
            pulse_s = drive = np.empty(0)
        rows[afferent] = ClassRow(answer.drive, pulse_s, drive.astype(np.float64), shaken)
    return color_figure(trace.time_s, trace.displacement_um, trace.force_n, rows, trace.title)
