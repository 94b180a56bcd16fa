"""A study: letters on many simulated fingers, from its plan to rows and summary; resumable."""

import csv
import hashlib
import io
import os
import warnings
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass, fields
from functools import partial
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any, Literal

import joblib
import numpy as np
from joblib import Parallel, delayed, parallel_config
from numpy.typing import NDArray
from pydantic import Field, field_validator
from threadpoolctl import threadpool_limits

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError, import_extra
from smarttouch.base.files import make_folder, read_text, write_bytes
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.anatomy import Anatomy, load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import ignore_nan, middle_90
from smarttouch.profile import Profile, load_profile
from smarttouch.profile.toml_tables import Table, UnfitError, load_model
from smarttouch.reading.legibility import (
    letter_sequences,
    letter_templates,
    letters_on_finger,
)
from smarttouch.reading.letter_shapes import ALPHABET
from smarttouch.stimulation.scan_sequence import ScanSequence


class Study(Table):
    """A grid: each finger of each anatomy, with each of everything else."""

    title: str = Field(min_length=1)
    """What is asked."""
    profiles: tuple[str, ...] = Field(default=("electric-mouse",), min_length=1, max_length=100)
    """Names or files of profiles."""
    anatomies: tuple[str, ...] = Field(default=("paper", "branched"), min_length=1, max_length=100)
    """Names or files of anatomies."""
    fingers: int = Field(default=10, ge=1, le=100_000)
    """Number of fingers of each anatomy, by seeds from 1 on."""
    modes: tuple[Literal["RA", "SAI", "PC", "natural"], ...] = Field(default=("RA",), min_length=1)
    """Whose receptors."""
    scans: tuple[Literal["points", "auto"], ...] = Field(default=("points",), min_length=1)
    """How points share slots."""
    intensities: tuple[float, ...] = Field(default=(1.0,), min_length=1, max_length=100)
    """Parts of the strongest comfortable current."""
    letters: str = Field(default=ALPHABET, min_length=1)
    """Letters shown on the fingers."""

    @field_validator("letters")
    @classmethod
    def _known(cls, letters: str) -> str:
        letters = "".join(dict.fromkeys(letters.upper()))
        if set(letters) - set(ALPHABET):
            raise UnfitError(f"letters {letters!r} must be from A to Z, as in T or AEIOU")
        return letters

    @field_validator("intensities")
    @classmethod
    def _possible(cls, intensities: tuple[float, ...]) -> tuple[float, ...]:
        for intensity in intensities:
            if not 0 < intensity <= 1:
                raise UnfitError(f"intensity {intensity:g} must be above 0 and at most 1")
        return intensities


def load_study(path: Path) -> Study:
    """Load the plan of a study."""
    return load_model(path, Study)


Advance = Callable[[int, int], None]
Letters = Mapping[str, tuple[ScanSequence, NDArray[np.bool_]]]  # slots, electrodes (E,)


@dataclass(frozen=True)
class Choice:
    """One choice of everything but the finger."""

    # profile, mode, scan: as the study names them
    profile: str
    mode: str
    scan: str
    intensity: float


@dataclass(frozen=True)
class StudyRow:
    """One finger and one pattern."""

    # profile, anatomy, finger, mode, scan, intensity: what was chosen; the finger is its seed
    profile: str
    anatomy: str
    finger: int
    mode: str
    scan: str
    intensity: float
    pattern: str  # the letter
    read_as: str  # letter that was read of the spikes
    error: float  # 1 where it was read as another, else 0
    # silent_points, wrong_class, misplaced: see `ResponseQuality`; NaN without a spike
    silent_points: float
    wrong_class: float
    misplaced: float
    spikes: int  # all spikes of a letter in ten periods
    # ra, sai, pc: afferents that fired
    ra: int
    sai: int
    pc: int
    slots: int  # slots of a period
    total_ma: float  # mean total current of a slot


HEADING = tuple(each.name for each in fields(StudyRow))


def as_csv(rows: Iterable[StudyRow]) -> str:
    """Return rows as CSV with a heading; numbers read back as they were."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(HEADING)
    writer.writerows(astuple(row) for row in rows)
    return text.getvalue()


def from_csv(text: str) -> list[StudyRow]:
    """Return the rows of a CSV text; ValueError if they are not of a study."""
    heading, *lines = csv.reader(io.StringIO(text, newline=""))
    if tuple(heading) != HEADING:
        raise ValueError("its columns are others")
    kinds: list[Any] = [column.type for column in fields(StudyRow)]
    return [
        StudyRow(*(kind(cell) for kind, cell in zip(kinds, line, strict=True))) for line in lines
    ]


def study_letters(
    study: Study, name: str, profile: Profile, progress: Advance | None = None
) -> list[tuple[Choice, Letters]]:
    """Return the letters as each choice with one of the study's profiles delivers them.

    `progress` is called with the number of sites of a bank that are designed, and of all, if any
    have to be.
    """
    bank = load_bank(profile, progress)
    return [
        (
            choice,
            letter_sequences(
                study.letters, profile, bank, Mode(choice.mode), choice.scan, choice.intensity
            ),
        )
        for combination in product(study.modes, study.scans, study.intensities)
        for choice in [Choice(name, *combination)]
    ]  # fmt: skip


def rows_of_letters(
    profile: Profile,
    shown: Sequence[tuple[Choice, Letters]],
    anatomy: Anatomy,
    name: str,
    seed: int,
) -> list[StudyRow]:
    """Return the rows of one finger for all letters in all choices of its profile."""
    known, rows = letter_templates(profile), []
    # One finger is one piece of work: the same numbers wherever it is done.
    with threadpool_limits(limits=1, user_api="blas"):
        finger = Finger(profile, seed, anatomy)
        for choice, letters in shown:
            for one in letters_on_finger(finger, letters, Mode(choice.mode).afferents, known):
                current_ua = letters[one.letter][0].current_ua
                total_ua = np.abs(current_ua.astype(np.int64)).sum()
                quality, slots = one.quality, len(current_ua)
                ra, sai, pc = (quality.afferents[afferent] for afferent in Afferent)
                rows.append(
                    StudyRow(
                        choice.profile, name, seed, choice.mode, choice.scan, choice.intensity,
                        one.letter, one.read_as, float(one.read_as != one.letter),
                        quality.silent_points, quality.wrong_class, quality.misplaced,
                        quality.spikes, ra, sai, pc, slots,
                        int(total_ua) / 2000 / max(1, slots),
                    )
                )  # fmt: skip
    return rows


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
    profiles = {name: load_profile(_beside(beside, name)) for name in study.profiles}
    anatomies = {name: load_anatomy(_beside(beside, name)) for name in study.anatomies}
    fingers = list(product(anatomies.items(), range(1, study.fingers + 1)))
    rows: dict[Path, list[StudyRow] | None] = {}
    missing: list[tuple[Path, Callable[[], list[StudyRow]]]] = []
    for chosen, profile in profiles.items():
        letters = study_letters(study, chosen, profile, designing)
        digest = joblib.hash(letters)
        for (name, anatomy), seed in fingers:
            path = parts / f"{_key(digest, profile, anatomy, name, seed)[:24]}.csv"
            rows[path] = _kept(path)
            if rows[path] is None:
                make_rows = partial(rows_of_letters, profile, letters, anatomy, name, seed)
                missing.append((path, make_rows))
    done = len(rows) - len(missing)
    with closing(_made([task for _, task in missing])) as finished:
        for index, finger_rows in finished:
            path = missing[index][0]
            write_bytes(path, as_csv(finger_rows).encode())
            rows[path] = finger_rows
            done += 1
            if progress is not None:
                progress(done, len(rows))
    table = [row for finger_rows in rows.values() for row in finger_rows or []]
    write_bytes(folder / ROWS_FILE, as_csv(table).encode())
    return table


def _beside(folder: Path, name: str) -> str | Path:
    """Return a file that lies beside the study, or the name as it is."""
    there = folder / name
    return there if os.path.isfile(there) else name  # noqa: PTH113 (Path raises on long names)


def _key(digest: str | None, profile: Profile, anatomy: Anatomy, name: str, seed: int) -> str:
    """Return a hash of all that the rows of a finger depend on."""
    models = [model.model_dump_json() for model in (profile, anatomy)]
    return hashlib.sha256(repr([VERSION, digest, name, seed, models]).encode()).hexdigest()


def _made(
    work: Sequence[Callable[[], list[StudyRow]]],
) -> Generator[tuple[int, list[StudyRow]], None, None]:
    """Yield rows as they are ready, with the index of their work."""
    many = Parallel(n_jobs=-1, return_as="generator_unordered", max_nbytes=None)
    results = many(delayed(_numbered)(index, task) for index, task in enumerate(work))
    try:
        for result in results:  # noqa: UP028 (close it below, not here)
            yield result
    finally:
        with warnings.catch_warnings():
            # Work under way is discarded on purpose.
            warnings.simplefilter("ignore", UserWarning)
            results.close()


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


def study_table(sums: Iterable[Summed]) -> tuple[list[str], list[list[str]]]:
    """Return a heading, and medians with the middle 90 % of each choice and anatomy in words."""
    heading = ["anatomy", "choice", "errors", "silent", "wrong", "misplaced", "mA"]
    rows = [
        [
            summed.anatomy, summed.label,
            *("{:.3f} ({:.2f}-{:.2f})".format(*summed.interval(name)) for name in MEASURES),
            f"{summed.total_ma:.2f}",
        ]
        for summed in sums
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
    try:
        client = dask.Client(address, timeout=_ANSWERS_WITHIN_S, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:
        raise SmartTouchError(
            f"no Dask scheduler answers at {address!r} ({error or type(error).__name__}): give its "
            "address as tcp://HOST:8786"
        ) from None
    with client, parallel_config("dask", client=client, wait_for_workers_timeout=60):
        yield
