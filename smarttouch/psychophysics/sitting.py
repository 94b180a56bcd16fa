"""One sitting of an experiment of the list: its files, its session, and what is said of it."""

import contextlib
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from itertools import count
from pathlib import Path

from smarttouch.clock import MonotonicClock
from smarttouch.errors import SmartTouchError
from smarttouch.profile import Profile
from smarttouch.psychophysics.catalog import Design
from smarttouch.psychophysics.rows import About, RowFile
from smarttouch.psychophysics.session import Session
from smarttouch.psychophysics.source import ExperimentSource
from smarttouch.psychophysics.subject import Subject, make_observer
from smarttouch.psychophysics.summary import summarize
from smarttouch.psychophysics.timing import TrialTiming


@dataclass(frozen=True)
class ExperimentSession:
    """One run of an experiment."""

    made: Design
    session: Session
    profile: Profile
    course: TrialTiming
    path: Path  # file of the answers

    def source(self, pressing_n: float | None, *, in_real_time: bool) -> ExperimentSource:
        """Return the source of its stimuli; force is made up if it is given."""
        clock = MonotonicClock() if in_real_time else None
        source = ExperimentSource(self.session, self.profile, self.course, pressing_n, clock)
        source.url = f"experiment:{self.session.title}"
        return source

    def subject(
        self,
        source: ExperimentSource,
        simulate: str,
        seed: int,
        finger: int = 1,
        anatomy: str | Path = "paper",
    ) -> Subject:
        """Return a listener who answers in place of a person, with a finger by its seed."""
        drawn = getattr(self.made.task, "drawn", None)
        observer = make_observer(
            simulate, self.profile, seed + self.session.resumed, drawn, finger, anatomy
        )
        return Subject(source, observer)

    def before(self) -> Iterator[str]:
        """Yield lines on it before it goes on."""
        session = self.session
        total = "" if session.total is None else f" of {session.total}"
        if session.resumed and not session.over:
            yield f"goes on at trial {session.resumed + 1}{total}: {self.path}"
        yield from self.made.notes

    def after(self) -> list[str]:
        """Return lines on how far it came."""
        return summarize(self.made, self.session, self.path)


@contextlib.contextmanager
def open_sitting(
    made: Design,
    profile: Profile,
    course: TrialTiming,
    about: About,
    path: Path,
    *,
    overwrite: bool,
) -> Iterator[ExperimentSession]:
    """Open the file of an experiment's answers for a block, and go on where it ends."""
    with RowFile(path, about, overwrite) as file:
        begun = datetime.now().astimezone().isoformat(timespec="seconds")
        session = Session(made.task, made.procedure, file, begun)
        yield ExperimentSession(made, session, profile, course, path)


def parse_standards(text: str | None) -> tuple[float, ...] | None:
    """Return the frequencies that ``15,30`` names, in Hz."""
    if text is None:
        return None
    try:
        standards = tuple(float(each) for each in text.split(","))
    except ValueError:
        standards = ()
    if not standards or not all(0 < each < 1e6 for each in standards):
        message = f"standards {text!r} are not understood: give frequencies in Hz, as in 15,30,45"
        raise SmartTouchError(message, about="standards")
    return tuple(dict.fromkeys(standards))


def usual_name(
    experiment: str, participant: str, session: str, seed: int | None
) -> tuple[str, int]:
    """Return what an experiment's file is called without ending, and the seed of its orders."""
    for parameter, name in (("participant", participant), ("session", session)):
        if any(not (each.isalnum() or each in "-_.") for each in name):
            raise SmartTouchError(
                f"{parameter} {name!r} becomes part of a file's name: use letters, digits, - and _",
                about=parameter,
            )
    if seed is not None and seed < 0:
        raise SmartTouchError(f"the seed {seed} must be 0 or more", about="seed")
    named = "-".join(each for each in (participant, session, experiment) if each)
    usual = zlib.crc32(f"{participant}/{session}".encode()) % 10_000
    return named, usual if seed is None else seed


def numbered(path: Path) -> Path:
    """Return a file's name with the next number, if there is one of that name."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(each for each in names if not each.exists()) if path.exists() else path
