"""Resumable study of letters on many simulated fingers: plan, rows and summary."""

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
from smarttouch.physiology.afferent_anatomy import Anatomy, load_anatomy
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
    """Plan of a study, which runs all combinations of the values in its lists."""

    title: str = Field(min_length=1)
    """Question that the study answers, in words."""
    profiles: tuple[str, ...] = Field(default=("electric-mouse",), min_length=1, max_length=100)
    """Names or files of profiles."""
    anatomies: tuple[str, ...] = Field(default=("paper", "branched"), min_length=1, max_length=100)
    """Names or files of anatomies."""
    fingers: int = Field(default=10, ge=1, le=100_000)
    """Number of fingers of each anatomy. The seeds of the fingers are 1, 2, 3 and so on."""
    modes: tuple[Literal["RA", "SAI", "PC", "natural"], ...] = Field(default=("RA",), min_length=1)
    """Modes: the classes to stimulate."""
    scans: tuple[Literal["points", "auto"], ...] = Field(default=("points",), min_length=1)
    """Scan modes: whether several points may share a slot."""
    intensities: tuple[float, ...] = Field(default=(1.0,), min_length=1, max_length=100)
    """Intensities, relative to the strongest comfortable current."""
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
    """Load the plan of a study from a TOML file."""
    return load_model(path, Study)


Advance = Callable[[int, int], None]
Letters = Mapping[str, tuple[ScanSequence, NDArray[np.bool_]]]  # sequence, mask of targets (E,)


@dataclass(frozen=True)
class Choice:
    """Combination of profile, mode, scan and intensity in a study."""

    # profile, mode, scan: names from the study
    profile: str
    mode: str
    scan: str
    intensity: float


@dataclass(frozen=True)
class StudyRow:
    """Result of one letter on one finger."""

    # The fields up to `intensity` identify the combination; `finger` is a seed.
    profile: str
    anatomy: str
    finger: int
    mode: str
    scan: str
    intensity: float
    pattern: str  # the letter
    read_as: str  # letter recognized from the spikes
    error: float  # 1 if `read_as` is another letter, else 0
    # silent_points, wrong_class, misplaced: see `ResponseQuality`; NaN without spikes
    silent_points: float
    wrong_class: float
    misplaced: float
    spikes: int  # number of spikes in ten periods
    # ra, sai, pc: numbers of afferents that fired
    ra: int
    sai: int
    pc: int
    slots: int  # slots per period
    total_ma: float  # mean total current of a slot


HEADING = tuple(each.name for each in fields(StudyRow))


def as_csv(rows: Iterable[StudyRow]) -> str:
    """Return rows as CSV with a heading. Numbers keep their full precision."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(HEADING)
    writer.writerows(astuple(row) for row in rows)
    return text.getvalue()


def from_csv(text: str) -> list[StudyRow]:
    """Parse rows from CSV. Raises ValueError if the text is not from a study."""
    heading, *lines = csv.reader(io.StringIO(text, newline=""))
    if tuple(heading) != HEADING:
        raise ValueError("the columns are not those of a study")
    kinds: list[Any] = [column.type for column in fields(StudyRow)]
    return [
        StudyRow(*(kind(cell) for kind, cell in zip(kinds, line, strict=True))) for line in lines
    ]


def study_letters(
    study: Study, name: str, profile: Profile, progress: Advance | None = None
) -> list[tuple[Choice, Letters]]:
    """Return the scan sequences of all letters for each mode, scan and intensity of the study.

    If kernels must be designed, `progress` is called with two counts: sites designed so far, and
    all sites to design.
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
    """Return the rows of one finger: one row for each letter of each combination in ``shown``."""
    known, rows = letter_templates(profile), []
    # With one BLAS thread the results are equal on every machine.
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


VERSION = 3  # increase it with each change of code that alters the rows of a study
ROWS_FILE = "rows.csv"
_PARTS = "parts"
_MOST_PART_BYTES = 100_000_000


def run_study(
    study: Study,
    beside: Path,  # folder to which file names in the study are relative
    folder: Path,  # folder of the results; created if missing
    designing: Advance | None = None,  # called with two counts: designed sites, all sites to design
    progress: Advance | None = None,  # called with two counts: simulated fingers, all fingers
) -> list[StudyRow]:
    """Run or resume a study, write ``rows.csv``, and return its rows.

    Rows are sorted by profile, anatomy, finger, combination and letter. `joblib.Parallel` computes
    several fingers at a time, by default on all cores. The rows of each finger are stored in a file
    in the folder. A later call reuses this file unless study, profile, anatomy or `VERSION` change.
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
            rows[path] = _stored_rows(path)
            if rows[path] is None:
                make_rows = partial(rows_of_letters, profile, letters, anatomy, name, seed)
                missing.append((path, make_rows))
    done = len(rows) - len(missing)
    with closing(_run_parallel([task for _, task in missing])) as finished:
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
    """Return the path of the file ``name`` in a folder, or ``name`` if there is no such file."""
    there = folder / name
    return there if os.path.isfile(there) else name  # noqa: PTH113 (Path raises on long names)


def _key(digest: str | None, profile: Profile, anatomy: Anatomy, name: str, seed: int) -> str:
    """Return a hash of everything that the rows of a finger depend on."""
    models = [model.model_dump_json() for model in (profile, anatomy)]
    return hashlib.sha256(repr([VERSION, digest, name, seed, models]).encode()).hexdigest()


def _run_parallel(
    work: Sequence[Callable[[], list[StudyRow]]],
) -> Generator[tuple[int, list[StudyRow]], None, None]:
    """Run tasks in parallel. Yield the index and the rows of each task when it is done."""
    many = Parallel(n_jobs=-1, return_as="generator_unordered", max_nbytes=None)
    results = many(delayed(_numbered)(index, task) for index, task in enumerate(work))
    try:
        for result in results:  # noqa: UP028 (yield from would close it outside catch_warnings)
            yield result
    finally:
        with warnings.catch_warnings():
            # joblib warns about unfinished work, which is discarded on purpose.
            warnings.simplefilter("ignore", UserWarning)
            results.close()


def _numbered(index: int, rows: Callable[[], list[StudyRow]]) -> tuple[int, list[StudyRow]]:
    return index, rows()


def _stored_rows(path: Path) -> list[StudyRow] | None:
    """Return the stored rows of a finger, or None if its file is missing or incomplete."""
    if not path.is_file():
        return None
    try:
        return from_csv(read_text(path, SmartTouchError, _MOST_PART_BYTES))
    except (SmartTouchError, ValueError, TypeError, csv.Error):
        return None  # the caller then computes the rows


MEASURES = ("error", "silent_points", "wrong_class", "misplaced")
TABLE_NOTE = (
    "Shares, as means over letters: errors (misread letters), silent (points without a spike "
    "nearby), wrong (spikes of other classes), misplaced (spikes away from the letter). The table "
    "shows the median and the middle 90 % over fingers. mA: mean total current of a slot."
)
_CHOSEN = ("profile", "mode", "scan", "intensity")


@dataclass(frozen=True)
class Summed:
    """Summary of one combination on all fingers of one anatomy."""

    anatomy: str
    label: str  # profile, mode, scan and intensity, as far as they vary in the study
    fingers: dict[str, list[float]]  # key: measure; value: mean over letters for each finger
    total_ma: float  # mean total current of a slot

    def interval(self, measure: str) -> tuple[float, float, float]:
        """Return the median over fingers and the bounds of their middle 90 %."""
        return middle_90(self.fingers[measure])


def study_sums(rows: Sequence[StudyRow]) -> list[Summed]:
    """Summarize the rows of each combination and anatomy, in the order of the rows."""
    differ = [name for name in _CHOSEN if len({getattr(row, name) for row in rows}) > 1]
    groups: dict[tuple[str, str], dict[int, list[StudyRow]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for row in rows:
        label = ", ".join(_as_text(row, name) for name in differ) or row.mode
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
    """Return a heading, and a row of text for each combination and anatomy."""
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


def _as_text(row: StudyRow, name: str) -> str:
    value = getattr(row, name)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _mean(rows: Iterable[StudyRow], name: str) -> float:
    return ignore_nan(fmean, (getattr(row, name) for row in rows))


_CONNECT_TIMEOUT_S = 10


@contextmanager
def on_cluster(address: str | None) -> Iterator[None]:
    """Run the `with` block on the Dask cluster of a scheduler (``tcp://HOST:8786``), or locally.

    The workers of the cluster need the same version of SmartTouch.
    """
    if address is None:
        yield
        return
    dask = import_extra("distributed", "a cluster", "cluster")
    try:
        client = dask.Client(address, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:
        raise SmartTouchError(
            f"no Dask scheduler answers at {address!r} ({error or type(error).__name__}): give its "
            "address as tcp://HOST:8786"
        ) from None
    with client, parallel_config("dask", client=client, wait_for_workers_timeout=60):
        yield
