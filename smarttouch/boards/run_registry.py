"""The run registry: a folder in which each run that may drive a finger has an entry.

``runs/ID.json`` describes a run. ``runs/ID.lock`` is locked until the process of the run ends. To
stop a run, `stop_all` writes ``runs/ID.stop``. The run looks for this file every 50 ms, sets its
boards to zero, and renames the file to ``ID.zero`` or ``ID.unconfirmed``. No process is signaled:
process id and start time only show whether a run has ended.
"""

import json
import os
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple
from uuid import uuid4

from platformdirs import user_state_path

from smarttouch.base.clock import now_ns
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import make_folder, replace_file
from smarttouch.base.posix import O_NOFOLLOW, try_lock

ANSWER_S = 3.0  # longest wait of `stop_all` for runs to confirm zero
_LOOK_S = 0.05
_LOOKS_PER_CHECK = 20  # in every 20th look (once a second), a run checks that its files exist
_LOCK_S = 2.0


class Answer(NamedTuple):
    """Result of stopping a run: a sentence, and whether the run has confirmed zero."""

    sentence: str
    at_zero: bool = False


@dataclass(frozen=True)
class _Run:
    """Run, as described by its file ``ID.json``; ``host`` is empty if the file is unreadable."""

    id: str
    host: str = ""
    boot: str = ""
    namespace: str = ""
    pid: int = 0
    start_ns: int = 0  # start time of the process; 0 if unknown
    current_ua: int = 0  # largest total current of all boards of the run

    @classmethod
    def read(cls, run_id: str) -> "_Run":
        with suppress(OSError, ValueError, TypeError):
            run = cls(**json.loads(_read(registry_folder() / f"{run_id}.json")) | {"id": run_id})
            # The sum raises TypeError if a value is not a number: the file is then invalid.
            if run.host and run.pid + run.start_ns + run.current_ua:
                return run
        return cls(run_id)

    def path(self, kind: str) -> Path:
        return registry_folder() / f"{self.id}.{kind}"

    def has(self, kind: str) -> bool:
        return os.path.lexists(self.path(kind))

    def remove(self, *kinds: str) -> None:
        for kind in kinds:
            with suppress(OSError):
                self.path(kind).unlink()

    @property
    def name(self) -> str:
        if not self.host:
            return f"the run of {self.path('json')}"
        return f"process {self.pid}" + ("" if self.is_here else f" on host {self.host}")

    @property
    def is_here(self) -> bool:
        """Whether the process id of the run is valid in this PID namespace."""
        return (self.host, self.boot, self.namespace) == _place()

    @property
    def is_locked(self) -> bool:
        with suppress(OSError):
            number = os.open(self.path("lock"), os.O_RDWR | O_NOFOLLOW)
            try:
                # Use a shared lock: another check must not mistake this lock for the lock of a run.
                return not try_lock(number, shared=True)
            finally:
                os.close(number)
        return False

    @property
    def has_ended(self) -> bool:
        """Whether the process of the run has certainly ended."""
        if not self.is_here:
            return False
        return _start_ns(self.pid) != self.start_ns if self.start_ns else not self.is_locked

    def answer(self, until_s: float) -> Answer:
        """Wait until the run has answered a stop, and describe the result."""
        name, late = self.name, False
        while not late:
            late = time.monotonic() > until_s
            # Check for the end first: otherwise an answer just before the end could be missed.
            ended = self.has_ended
            withdrawn = registry_folder().exists() and not (self.has("json") or self.is_locked)
            if self.has("unconfirmed"):
                return Answer(f"{name} could not confirm zero: switch the board off")
            # A run without an entry has closed its boards, perhaps before the stop.
            if withdrawn or (self.has("zero") and not self.has("stop")):
                self.remove("stop")
                return Answer(f"{name} has confirmed zero", at_zero=True)
            if ended:
                return Answer(f"{name} ended without confirming zero: switch the board off")
            time.sleep(0.01)
        if self.is_here or self.is_locked:
            return Answer(f"{name} did not answer: switch the board off")
        if self.host not in ("", socket.gethostname()):
            return Answer(f"1 run is on host {self.host}: stop it there")
        # The entry is invalid, or it comes from an earlier boot or a container. Remove its files.
        # If the run still exists, its `_watch` notices the missing files and ends the run.
        self.remove("json", "lock", "stop")
        return Answer(f"{name} did not answer: if it still drives a board, switch the board off")


class RunEntry:
    """Entry of this process in the run registry.

    ``on_stop(reason)`` is called when the run must stop; it returns whether all boards are at zero.
    """

    def __init__(self, on_stop: Callable[[str], bool]) -> None:
        self.lost_a_board = False  # whether a board was closed without confirming zero
        self._on_stop, self._over = on_stop, threading.Event()
        self._run = _Run(uuid4().hex, *_place(), os.getpid(), _start_ns(os.getpid()))
        make_folder(registry_folder())
        flags = os.O_RDWR | os.O_CREAT | O_NOFOLLOW
        self._lock_number = os.open(self._run.path("lock"), flags, 0o600)
        # If the file cannot be locked, a stop still reaches this run.
        try_lock(self._lock_number)
        self._announce(0)
        self._stop_file = str(self._run.path("stop"))
        threading.Thread(target=self._watch, name="stop requests", daemon=True).start()

    @property
    def is_asked(self) -> bool:
        """Whether a stop has asked this run to end."""
        return os.path.lexists(self._stop_file)

    def declare(self, current_ua: int, most_ua: int = 0) -> int:
        """Record the current of this process, µA. If it is not larger than the one recorded before,
        record it without a check and return it. Otherwise, return the sum of the currents of all
        processes, and record the current only if the sum does not exceed ``most_ua``."""
        if current_ua <= self._run.current_ua:
            self._announce(current_ua)
            return current_ua
        with (registry_folder() / "lock").open("w") as file:
            deadline_s = time.monotonic() + _LOCK_S
            while not try_lock(file.fileno()):
                if time.monotonic() > deadline_s:
                    raise SmartTouchError(
                        f"another program has held {file.name} for {_LOCK_S:g} s: end that "
                        "program and try again"
                    )
                time.sleep(0.01)
            total_ua = current_ua + sum(
                run.current_ua
                for run in _listed()
                if run.id != self._run.id and not run.has_ended and (run.is_locked or run.is_here)
            )
            if total_ua <= most_ua:
                self._announce(current_ua)
        return total_ua

    def withdraw(self) -> None:
        """Remove the entry; tell a waiting `stop_all` whether all boards have confirmed zero."""
        self._over.set()
        if self.lost_a_board:
            with suppress(OSError):
                self._run.path("unconfirmed").touch(0o600)
        self._answer(not self.lost_a_board)
        self.close()
        self._run.remove("json", "lock", "stop", "zero")

    def close(self) -> None:
        """Release the lock in a forked process; the entry stays with the parent."""
        os.close(self._lock_number)

    def _announce(self, current_ua: int) -> None:
        self._run = replace(self._run, current_ua=current_ua)
        replace_file(self._run.path("json"), json.dumps(asdict(self._run)).encode())

    def _watch(self) -> None:
        looks = 0
        while not self._over.wait(_LOOK_S):
            looks, reason = looks + 1, "smarttouch stop" * self.is_asked
            # End a run whose files are gone: no stop could find it. Ignore disk errors.
            for kind in ("json", "lock") if looks % _LOOKS_PER_CHECK == 0 else ():
                with suppress(OSError):
                    if not (reason or self._run.path(kind).exists() or self._over.is_set()):
                        reason = f"the loss of {self._run.path(kind)}"
            if reason:
                self._answer(self._on_stop(reason))

    def _answer(self, at_zero: bool) -> None:
        with suppress(OSError):
            # Rename the file: on a full disk, writing a new one would fail.
            self._run.path("stop").replace(self._run.path("zero" if at_zero else "unconfirmed"))


def stop_all() -> list[Answer]:
    """Stop all registered runs of this user, and prevent running programs from opening boards.

    Return the result for each run, after at most 3 s. An error with one run does not prevent
    stopping others.
    """
    global _begun_ns
    problems, asked = [], []
    # Act as if this program started only now: it may still open boards to set them to zero.
    _begun_ns = now_ns()
    # Write the file ``stopped`` before listing runs: runs that register later read it and end.
    try:
        make_folder(registry_folder())
        replace_file(registry_folder() / "stopped", f"{_place()[1]} {_begun_ns}".encode())
    except OSError as error:
        problems.append(
            f"runs that are starting may still open a board ({error}): run smarttouch stop again"
        )
    for run in _listed():
        if run.has_ended:
            run.remove("json", "lock", "stop", "zero", "unconfirmed")
            continue
        try:
            # Remove the answer "unconfirmed" to an earlier stop, but keep the answer "zero".
            run.remove("unconfirmed")
            run.path("stop").touch(0o600)
            asked.append(run)
        except OSError as error:
            problems.append(f"{run.name} cannot be asked to stop ({error}): switch the board off")
    deadline_s = time.monotonic() + ANSWER_S
    answers = [run.answer(deadline_s) for run in asked]
    # Wait longer than 10 ms, the resolution of process start times. Otherwise a program that starts
    # after this call could count as stopped.
    time.sleep(0.02)
    return [*answers, *map(Answer, problems)]


def registry_folder() -> Path:
    """Return the folder of the run registry, which may not exist yet."""
    return user_state_path("smarttouch", appauthor=False) / "runs"


def stopped_since_start() -> bool:
    """Return whether `stop_all` was called after the start of this program."""
    with suppress(OSError, ValueError):
        boot, time_ns = _read(registry_folder() / "stopped").split()
        return boot == _place()[1] and _begun_ns < int(time_ns) <= now_ns()
    return False


def _start_ns(pid: int) -> int:
    """Return the start time of a process, by the clock of `now_ns`; 0 if it has ended or the time
    is unknown."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return 0 if fields[0] == "Z" else int(fields[19]) * 10**9 // os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return 0


_begun_ns = _start_ns(os.getpid()) or now_ns()  # program start; a forked process keeps the value


def _place() -> tuple[str, str, str]:
    """Return host, boot id and PID namespace: together they make a process id unique."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return socket.gethostname(), boot, str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return socket.gethostname(), "unknown", ""


def _listed() -> list[_Run]:
    """Return all registered runs, including those that are just being registered."""
    try:
        paths = [*registry_folder().iterdir()]
    except FileNotFoundError:
        return []
    except OSError as error:
        message = f"cannot look for runs in {error.filename}: {error.strerror}"
        raise SmartTouchError(message) from None
    # Also look at lock files: a listing may miss a JSON file that is being replaced.
    names = sorted({path.stem for path in paths if path.suffix in (".json", ".lock")})
    runs = map(_Run.read, names)
    return [run for run in runs if run.path("json").exists() or run.is_locked]


def _read(path: Path) -> str:
    # Read only regular files: reading a pipe might block.
    return path.read_text() if path.is_file() else ""
