"""Report of the response of each class and of its pulses, as numbers."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from smarttouch.afferent import Afferent
from smarttouch.vibrotactile.crosstalk import PacinianCrosstalk
from smarttouch.vibrotactile.mix import Mixture
from smarttouch.vibrotactile.source import ColorSource
from smarttouch.vibrotactile.split import Answer, shares


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


def answered(answers: Mapping[Afferent, Answer]) -> dict[Afferent, Answered]:
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


def answer_rows(answers: Mapping[Afferent, Answer]) -> list[tuple[str, ...]]:
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
    answers: Mapping[Afferent, Answer], mixture: Mixture, source: ColorSource
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


def notes(mixture: Mixture, answers: Mapping[Afferent, Answer]) -> list[str]:
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
    answers: Mapping[Afferent, Answer],
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
