"""Summary of a study: medians over fingers, and how many fingers read each pattern best."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean, median

from smarttouch.physiology.felt import over
from smarttouch.studies.rows import Row

MEASURES = ("error", "silent_points", "wrong_class", "misplaced")
NAMES = {
    "error": "read wrongly",
    "silent_points": "silent points",
    "wrong_class": "spikes of another class",
    "misplaced": "misplaced spikes",
}
_CHOSEN = ("profile", "kernels", "mode", "scan", "intensity")


@dataclass(frozen=True)
class Summed:
    """One choice on the fingers of one anatomy."""

    anatomy: str
    label: str  # what the choice is, where choices of the study differ
    fingers: dict[str, list[float]]  # mean over patterns of each of `MEASURES`, by finger
    # part of the fingers on which no other choice is read with fewer errors; ties count for all
    best: float
    total_ma: float  # mean total current of a slot

    def middle(self, measure: str) -> float:
        """Return the median over fingers."""
        return over(median, self.fingers[measure])


def summed(rows: Sequence[Row]) -> list[Summed]:
    """Return each choice on each anatomy, in the order of the rows."""
    differ = [name for name in _CHOSEN if len({getattr(row, name) for row in rows}) > 1]
    groups: dict[tuple[str, str], dict[int, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        label = ", ".join(_said(row, name) for name in differ) or row.kernels
        groups[row.anatomy, label][row.finger].append(row)
    errors = {
        key: {seed: fmean(row.error for row in them) for seed, them in by_finger.items()}
        for key, by_finger in groups.items()
    }
    least: dict[tuple[str, int], float] = {}
    for (anatomy, _), each in errors.items():
        for seed, error in each.items():
            least[anatomy, seed] = min(error, least.get((anatomy, seed), error))
    return [
        Summed(
            anatomy,
            label,
            {name: [_mean(them, name) for them in by_finger.values()] for name in MEASURES},
            fmean(
                error <= least[anatomy, seed] + 1e-9
                for seed, error in errors[anatomy, label].items()
            ),
            fmean(row.total_ma for them in by_finger.values() for row in them),
        )
        for (anatomy, label), by_finger in groups.items()
    ]


def table_rows(found: Iterable[Summed]) -> tuple[list[str], list[list[str]]]:
    """Return a heading, and the medians of each choice and anatomy in words."""
    heading = ["anatomy", "choice", "errors", "silent", "wrong", "misplaced", "best on", "mA"]
    rows = [
        [
            each.anatomy, each.label, *(f"{each.middle(name):.3f}" for name in MEASURES),
            f"{each.best:.0%}", f"{each.total_ma:.2f}",
        ]
        for each in found
    ]  # fmt: skip
    return heading, rows


def _said(row: Row, name: str) -> str:
    value = getattr(row, name)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _mean(rows: Iterable[Row], name: str) -> float:
    return over(fmean, (getattr(row, name) for row in rows))
