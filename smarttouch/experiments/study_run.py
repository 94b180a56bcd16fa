"""A study from its plan to table and summary, finger by finger, on all cores, resumable."""

import csv
import hashlib
import warnings
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import fmean

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import make_folder, read_text, write_bytes
from smarttouch.base.lazy_names import import_extra
from smarttouch.experiments.study_plan import (
    Advance,
    Grid,
    Shown,
    Study,
    StudyRow,
    as_csv,
    from_csv,
)
from smarttouch.physiology.anatomy import Anatomy
from smarttouch.physiology.response import ignore_nan, middle_90

VERSION = 3  # version of the rows, raised when the same study would get others
ROWS_FILE = "rows.csv"
_PARTS = "parts"
_MOST_PART_BYTES = 100_000_000


def run_study(
    study: Study,
    beside: Path,  # folder from which the study names files
    folder: Path,  # where to; made if missing
    # designing, progress: called with how many sites of a bank, and fingers, are done, of how many
    designing: Advance | None = None,
    progress: Advance | None = None,
) -> list[StudyRow]:
    """Run a study, or what is left of it, and return its table, which is also in ``rows.csv``.

    Rows are by profile, anatomy, finger, choice and letter. The work goes through
    `joblib.Parallel`: on all cores, or wherever ``joblib.parallel_config`` sends it. Rows of
    finished fingers are kept in the folder, each finger's in a file of its own, and are used again
    where all that they depend on is the same.
    """
    parts = folder / _PARTS
    try:
        make_folder(parts)
    except OSError as error:
        raise SmartTouchError(f"cannot make the folder {folder}: {error.strerror}") from None
    grid = Grid(study, beside, designing)
    rows: dict[Path, list[StudyRow] | None] = {}
    missing: list[tuple[Path, Callable[[], list[StudyRow]]]] = []
    for shown in grid.shown():
        for finger in grid.fingers():
            path = parts / f"{_key(shown, *finger)[:24]}.csv"
            rows[path] = _kept(path)
            if rows[path] is None:
                missing.append((path, partial(shown.made, *finger)))
    done = len(rows) - len(missing)
    with closing(_made([each for _, each in missing])) as made:
        for index, found in made:
            path = missing[index][0]
            write_bytes(path, as_csv(found).encode())
            rows[path] = found
            done += 1
            if progress is not None:
                progress(done, len(rows))
    table = [row for found in rows.values() for row in found or []]
    write_bytes(folder / ROWS_FILE, as_csv(table).encode())
    return table


def _key(shown: Shown, anatomy: Anatomy, name: str, seed: int) -> str:
    """Return a hash of all that the rows of a finger depend on."""
    models = [each.model_dump_json() for each in (shown.profile, anatomy)]
    return hashlib.sha256(repr([VERSION, shown.digest, name, seed, models]).encode()).hexdigest()


def _made(
    work: Sequence[Callable[[], list[StudyRow]]],
) -> Generator[tuple[int, list[StudyRow]], None, None]:
    """Yield rows as they are ready, with the index of their work."""
    from joblib import Parallel, delayed

    many = Parallel(n_jobs=-1, return_as="generator_unordered", max_nbytes=None)
    made = many(delayed(_numbered)(index, each) for index, each in enumerate(work))
    try:
        for each in made:  # noqa: UP028, as the other way would close it outside of this
            yield each
    finally:
        with warnings.catch_warnings():
            # Work under way is discarded on purpose.
            warnings.simplefilter("ignore", UserWarning)
            made.close()


def _numbered(index: int, rows: Callable[[], list[StudyRow]]) -> tuple[int, list[StudyRow]]:
    return index, rows()


def _kept(path: Path) -> list[StudyRow] | None:
    """Return the rows of a finished finger, if its file is whole."""
    if not path.is_file():
        return None
    try:
        return from_csv(read_text(path, SmartTouchError, _MOST_PART_BYTES))
    except (SmartTouchError, ValueError, TypeError, csv.Error):
        # It is computed again: slow, not wrong.
        return None


MEASURES = ("error", "silent_points", "wrong_class", "misplaced")
TABLE_NOTE = (
    "Medians and middle 90 % of fingers, of means over patterns: read wrongly, silent points, "
    "spikes of another class, misplaced ones. mA: mean total current of a slot."
)
_CHOSEN = ("profile", "mode", "scan", "intensity")


@dataclass(frozen=True)
class Summed:
    """One choice on the fingers of one anatomy."""

    anatomy: str
    label: str  # what the choice is, where choices of the study differ
    fingers: dict[str, list[float]]  # mean over patterns of each of `MEASURES`, by finger
    total_ma: float  # mean total current of a slot

    def interval(self, measure: str) -> tuple[float, float, float]:
        """Return the median over fingers, and the bounds of their middle 90 %."""
        return middle_90(self.fingers[measure])


def study_sums(rows: Sequence[StudyRow]) -> list[Summed]:
    """Return each choice on each anatomy, in the order of the rows."""
    differ = [name for name in _CHOSEN if len({getattr(row, name) for row in rows}) > 1]
    groups: dict[tuple[str, str], dict[int, list[StudyRow]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for row in rows:
        label = ", ".join(_said(row, name) for name in differ) or row.mode
        groups[row.anatomy, label][row.finger].append(row)
    return [
        Summed(
            anatomy,
            label,
            {name: [_mean(them, name) for them in by_finger.values()] for name in MEASURES},
            fmean(row.total_ma for them in by_finger.values() for row in them),
        )
        for (anatomy, label), by_finger in groups.items()
    ]


def study_table(found: Iterable[Summed]) -> tuple[list[str], list[list[str]]]:
    """Return a heading, and medians with the middle 90 % of each choice and anatomy in words."""
    heading = ["anatomy", "choice", "errors", "silent", "wrong", "misplaced", "mA"]
    rows = [
        [
            each.anatomy, each.label,
            *("{:.3f} ({:.2f}-{:.2f})".format(*each.interval(name)) for name in MEASURES),
            f"{each.total_ma:.2f}",
        ]
        for each in found
    ]  # fmt: skip
    return heading, rows


def _said(row: StudyRow, name: str) -> str:
    value = getattr(row, name)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _mean(rows: Iterable[StudyRow], name: str) -> float:
    return ignore_nan(fmean, (getattr(row, name) for row in rows))


_ANSWERS_WITHIN_S = 10


@contextmanager
def on_cluster(address: str | None) -> Iterator[None]:
    """Run what is within on the Dask cluster of a scheduler (``tcp://HOST:8786``); here if None.

    Its workers need this version of SmartTouch.
    """
    if address is None:
        yield
        return
    dask = import_extra("distributed", "a cluster", "cluster")
    from joblib import parallel_config

    try:
        client = dask.Client(address, timeout=_ANSWERS_WITHIN_S, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:
        raise SmartTouchError(
            f"no Dask scheduler answers at {address!r} ({error or type(error).__name__}): give its "
            "address as tcp://HOST:8786"
        ) from None
    with client, parallel_config("dask", client=client, wait_for_workers_timeout=60):
        yield
