"""Threshold session: the trials of many electrodes, each result saved at once."""

import json
import os
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import CalibrationError
from smarttouch.base.files import (
    open_alone,
    read_bytes,
    unwritable,
)
from smarttouch.base.stopping import Closing
from smarttouch.boards.board import Board
from smarttouch.experiments.calibration.threshold_procedures import (
    AscendingLimits,
    Thresholds,
    ceiling_ma,
    measuring_profile,
    slew_ma_s,
)
from smarttouch.experiments.psychophysics.observers import KnownObserver
from smarttouch.experiments.psychophysics.procedures import Condition
from smarttouch.experiments.psychophysics.trials import Answer, Stimuli, Train, Trial
from smarttouch.profile import Profile

_RESULT = TypeAdapter(tuple[int, Thresholds])


class Progress(Closing):
    """Results of a threshold session until now, by electrode: lines of JSON beside the profile to
    be written, each on disk before `keep` returns.

    They count only where `settings`, the first line, are the same. Until it is closed no other
    session can continue the same file.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        self.path = path
        self.found: dict[int, Thresholds] = {}
        self._file = open_alone(path, CalibrationError)
        try:
            self._begin(settings)
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file, and remove it if it has no results."""
        if not self._file.closed and not self.found:
            self.path.unlink(missing_ok=True)
        self._file.close()

    def keep(self, site: int, found: Thresholds) -> None:
        """Add the result of an electrode."""
        self.found[site] = found
        self._write([site, asdict(found)])

    def forget(self) -> None:
        """Remove the file once the profile has the results."""
        self.path.unlink(missing_ok=True)

    def _begin(self, settings: Mapping[str, Any]) -> None:
        """Read existing lines, and drop one that was cut off."""
        data = read_bytes(self.path, CalibrationError)
        whole = data[: data.rfind(b"\n") + 1]
        try:
            first, *lines = whole.splitlines() if data else [json.dumps(settings).encode()]
            before = dict(json.loads(first))
            self.found = dict(map(_RESULT.validate_json, lines))
            felt = [each for each in self.found.values() if each.felt]
            if any(not 0 < each.threshold_ma <= each.comfort_ma for each in felt):
                raise ValueError("a threshold above comfort")
        except (ValueError, TypeError):
            raise CalibrationError(
                f"{self.path} is not the beginning of a threshold session: remove it to start over"
            ) from None
        for key, value in settings.items():
            if before.get(key) != value:
                raise CalibrationError(
                    f"{self.path} was begun with {key} {before.get(key)}, not {value}: go on with "
                    "the same, or remove it to start over"
                )
        self._file.truncate(len(whole))
        self._file.seek(len(whole))
        if not whole:
            self._write(settings)

    def _write(self, value: object) -> None:
        try:
            self._file.write(json.dumps(value).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise unwritable(CalibrationError, self.path, error) from None


TRIAL_S = 0.8
_SLOWER = 0.98  # part of the largest slope at which a current rises
_ANY_KEY = {"\n": "y"}

_Trials = Generator[Trial, Answer, Thresholds]


class ThresholdSession:
    """Trials that measure one electrode after the other."""

    title = "thresholds"

    def __init__(
        self,
        profile: Profile,  # to be measured
        board: Board,  # its own largest current counts too, from when it is open
        sites: Sequence[int],
        # keeps each electrode as it is done; those that it has already are left out
        progress: Progress,
        *,
        repeats: int = 3,  # of the rising current
        seed: int = 0,  # of all that is drawn
        # given each electrode and its result
        show: Callable[[int, Thresholds], None] = lambda _site, _found: None,
    ) -> None:
        self._profile, self._board = profile, board
        self._measuring = measuring_profile(profile)
        self._sites, self._progress = sites, progress
        self._repeats, self._seed, self._show = repeats, seed, show
        self._trials = self._measure_all()
        self._next: Trial | None = None
        self._begun = False

    @property
    def done(self) -> int:
        """Number of electrodes that are over."""
        return len(self._progress.found.keys() & set(self._sites))

    @property
    def total(self) -> int:
        """Number of electrodes."""
        return len(self._sites)

    @property
    def over(self) -> bool:
        """True if all electrodes are measured."""
        return self.done == self.total

    def next(self) -> Trial | None:
        """Return the next trial; None after the last."""
        if not self._begun:
            self._begun, self._next = True, next(self._trials, None)
        return self._next

    def record(self, trial: Trial, answer: Answer) -> None:
        """Process an answer; a result is on disk after that."""
        try:
            self._next = self._trials.send(answer)
        except StopIteration:
            self._next = None

    def _measure_all(self) -> Generator[Trial, Answer, None]:
        for site in self._sites:
            if site not in self._progress.found:
                found = yield from self._measure(site)
                self._progress.keep(site, found)
                self._show(site, found)

    def _measure(self, site: int) -> _Trials:
        """Return the result of one electrode; a second attempt is made if it is implausible."""
        found = yield from self._rise(site, 0)
        if found.felt and not found.usable:
            found = yield from self._rise(site, 1)
        return found

    def _rise(self, site: int, attempt: int) -> _Trials:
        course = AscendingLimits(
            ceiling_ma(self._profile, site, self._board),
            float(self._profile.threshold_ma[site]),
            self._repeats,
            _SLOWER * slew_ma_s(self._measuring, site),
            (self._seed, site, attempt),
        )
        yield Trial(
            Condition(0.0, np.nan, 0, attempt, site),
            (self._train(site, TRIAL_S),),
            task="felt",
            question=f"electrode {site}: a key when you feel it, again when it is strong enough",
            answers=_ANY_KEY,
            target="",
            success="",
            words=f"electrode {site}, current rises",
            unit="mA",
            exact=True,
            course=course,
        )
        return course.result()

    def _train(self, site: int, seconds: float) -> Train:
        pulse = self._measuring.pulse
        # At two pulses a train begins.
        longest_s = max(seconds, 2 / pulse.rate_hz)
        return Stimuli(self._measuring, Afferent.RA, longest_s).train([site], pulse.rate_hz)


def simulated_finger(
    profile: Profile, measuring: Profile, ceilings_ma: Sequence[float], seed: int
) -> KnownObserver:
    """Return an observer with electrodes that differ, none above its ceiling."""
    random = np.random.default_rng(seed)
    threshold_ma, enough_ma = [], []
    for usual_ma, top_ma in zip(profile.threshold_ma.tolist(), ceilings_ma, strict=True):
        delivered_ma = min(usual_ma * float(np.exp(0.2 * random.standard_normal())), 0.6 * top_ma)
        threshold_ma.append(delivered_ma)
        enough_ma.append(min(delivered_ma * random.uniform(1.5, 2.2), 0.95 * top_ma))
    return KnownObserver(
        measuring, np.array(threshold_ma, np.float32), np.array(enough_ma, np.float32), seed,
        guess=0.005, lapse=0.03,
    )  # fmt: skip
