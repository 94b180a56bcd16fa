"""Seal of boards: no driver may replace their gate, their stop, or the refusal of what is late."""

import contextlib
import inspect
import threading
from abc import ABCMeta, abstractmethod
from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, final
from weakref import finalize

import numpy as np

from smarttouch.base.clock import LATE_NS, Clock, MonotonicClock
from smarttouch.base.errors import BoardError, BoardFaultError, BoardStoppedError, SequenceLateError
from smarttouch.base.registry import final_names, is_final
from smarttouch.stimulation.safety_gate import NanosecondClock, SafetyGate, SafetyLimits

_ALWAYS = frozenset({"__bases__", "__class__", "__getattribute__", "_sealed"})
"""Names through which final methods could be replaced."""
_OF_OBJECTS = frozenset({"_clock", "_gate", "_halted", "_opened", "_stopped"})
"""Names of each board's own attributes, which a property of a class would hide."""
_GATE = frozenset(vars(SafetyGate))
_WHOLE = [name for name, value in vars(SafetyLimits).items() if isinstance(value, cached_property)]


class SealedType(ABCMeta):
    """Metaclass that forbids replacing final methods, in subclasses and later."""

    _sealed = _ALWAYS

    def __init__(
        cls, name: str, bases: tuple[type, ...], members: dict[str, Any], **more: Any
    ) -> None:
        super().__init__(name, bases, members, **more)
        own = {each for each, member in members.items() if is_final(member)}
        above = [getattr(each, "_sealed", None) or final_names(each) for each in bases]
        type.__setattr__(cls, "_sealed", _ALWAYS.union(own, *above))
        static = inspect.getattr_static
        if static(cls, "__getattribute__") is not object.__getattribute__:
            raise _replaced(cls, "__getattribute__")
        for each in sorted(_OF_OBJECTS):
            if static(cls, each, None) is not None:
                raise _replaced(cls, each)
        for base in cls.__mro__[1:]:
            for each in sorted(getattr(base, "_sealed", frozenset()) - _ALWAYS):
                if static(cls, each) is not static(base, each):
                    raise _replaced(cls, each)

    # Hidden from type checkers, which would let any name be assigned.
    if not TYPE_CHECKING:

        def __setattr__(cls, name: str, value: object) -> None:
            if name in cls._sealed or name in _OF_OBJECTS:
                raise _replaced(cls, name)
            super().__setattr__(name, value)

        def __delattr__(cls, name: str) -> None:
            if name in cls._sealed:
                raise _replaced(cls, name)
            super().__delattr__(name)


class Sealed(metaclass=SealedType):
    """Base class of objects whose final methods cannot be replaced."""

    if not TYPE_CHECKING:

        @final
        def __setattr__(self, name: str, value: object) -> None:
            if name in type(self)._sealed:
                raise _replaced(type(self), name)
            object.__setattr__(self, name, value)


def _replaced(kind: type, name: str) -> BoardError:
    return BoardError(
        f"{kind.__name__} replaces {name}, which keeps every board safe: implement the underscored "
        "methods of Board instead"
    )


class _Seal(NamedTuple):
    """Gate, limits and clock that a board was made with."""

    gate: SafetyGate
    gate_size: int
    limits: SafetyLimits
    values: tuple[Any, ...]  # of the limits, as given and in whole numbers
    clock: NanosecondClock | None
    on_a_finger: bool
    foreign: bool


_seals: dict[int, _Seal] = {}  # by the id of the board: in it, a driver could change them


def make_gate(board: Any, limits: SafetyLimits, clock: NanosecondClock | None) -> SafetyGate:
    """Return the sealed gate of a board; the first gate of a board must stay its gate."""
    for name in _WHOLE:
        value = getattr(limits, name)
        if isinstance(value, np.ndarray) and value.flags.owndata:
            # Backed by bytes, it cannot be made writable again.
            vars(limits)[name] = np.frombuffer(value.tobytes(), value.dtype)
    gate = SafetyGate(limits, clock)
    if id(board) not in _seals:
        _seals[id(board)] = _Seal(
            gate, len(vars(gate)), limits, tuple(vars(limits).values()), gate._clock,
            bool(board.on_a_finger), is_foreign(board),
        )  # fmt: skip
        finalize(board, _seals.pop, id(board)).atexit = False
    return gate


def seal_fault(board: Any) -> BoardError | None:
    """Return the error of a board whose gate, limits or clock were exchanged, or None. As it runs
    before every sequence, slow checks run only where something has changed."""
    seal, own = _seals.get(id(board)), vars(board)
    about = remedy = ""
    if (
        seal is None
        or own.get("_gate") is not seal.gate
        or type(seal.gate) is not SafetyGate
        or (len(vars(seal.gate)) != seal.gate_size and not _GATE.isdisjoint(vars(seal.gate)))
    ):
        about, remedy = "gate", "leave _gate as it is"
    elif seal.gate.limits is not seal.limits or not _same(
        tuple(vars(seal.limits).values()), seal.values
    ):
        about, remedy = "limits", "hand those that it is given to super().__init__, unchanged"
    elif "send" in own or "stop" in own or "halt" in own or "close" in own or "measure" in own:
        about = min(type(board)._sealed & own.keys())
        remedy = "implement the underscored methods of Board instead"
    elif seal.gate._clock is not seal.clock or (seal.foreign and _has_own_clock(board)):
        about, remedy = "clock", "leave _time and _clock as they are"
    elif seal.on_a_finger and not board.on_a_finger:
        about, remedy = "on_a_finger", "let the class say it, once"
    else:
        return None
    return seal_error(board, about, remedy)


def seal_error(board: Any, about: str, remedy: str) -> BoardError:
    """Return the error of a board that bypasses its gate."""
    kind = type(board).__name__
    return BoardError(f"{kind} goes around the safety gate by its {about}: {remedy}")


def _same(found: tuple[Any, ...], kept: tuple[Any, ...]) -> bool:
    """Return whether two tuples hold the same or equal objects."""
    try:
        return found == kept
    except ValueError:
        # An array was exchanged.
        return False


def is_foreign(board: Any) -> bool:
    """Return whether the driver is of another package."""
    return not type(board).__module__.startswith("smarttouch.")


def _has_own_clock(board: Any) -> bool:
    """Return whether the time of a board with a finger on it is not the machine's."""
    # Only without a finger may time be what sequences state.
    return bool(board.on_a_finger) and (
        type(board._clock) is not MonotonicClock
        or "now_ns" in vars(board._clock)
        or "_time" in vars(board)
    )


WRITE_S = 0.6  # longest time that a stop waits for one write: ports give up after .5 s


class TimedBoard(Sealed):
    """Base class that tracks stops and refuses late sequences.

    It uses the machine's own clock, whatever clock a program passes.
    """

    simulated_time: ClassVar[bool] = False
    """Whether its time is simulated, without waiting."""
    dropped_late: int = 0
    """Number of sequences that were not sent because they were too late."""
    _spins: ClassVar[bool] = True
    """Whether waits for a deadline end spun: not where a board itself begins sequences in time."""

    def __init__(self) -> None:
        self._clock: Clock = MonotonicClock(None if self._spins else 0)
        self._due_ns = 0  # planned start of the present sequence, by the clock
        self._stopped = threading.Event()
        self._halted = False
        self._fault_found: BoardFaultError | None = None  # fault that latched the board
        # Reentrant: a signal handler may stop while its own thread is writing.
        self._writing = threading.RLock()
        self._writes = 0
        self._overtaken = False  # whether a stop did not wait for the write under way
        self._zeroed = False  # whether a stop has put the board at zero

    @property
    @final
    def clock(self) -> Clock:
        """Clock of planned sequences."""
        return self._clock

    @final
    def _begin_unless_halted(self) -> None:
        self._overtaken = self._zeroed = False
        self._stopped.clear()
        # In this order: a halt from another thread is seen here or comes later.
        if self._halted:
            self._stopped.set()
        self._go_on_unless_stopped()

    @final
    def _go_on_unless_stopped(self) -> None:
        if self._stopped.is_set():
            if self._fault_found is not None:
                raise self._fault_found
            again = "open a new display" if self._halted else "open it again"
            raise BoardStoppedError(
                f"the board was stopped, all electrodes are at zero: {again} before sending"
            )

    @final
    @contextlib.contextmanager
    def _driving(self) -> Iterator[None]:
        """Hold the lock of `stop` for one write that makes current; nothing else waits within.

        A stop takes effect before the write, which is then refused, or after it. A write that
        lasts longer than `WRITE_S`, or in which a signal handler stops the board, is followed by
        zero.

        Raises
        ------
        BoardStoppedError
            If the board was stopped.
        """
        with self._writing:
            self._go_on_unless_stopped()
            self._writes += 1
            try:
                yield
            finally:
                self._writes -= 1
                if self._overtaken and not self._writes:
                    self._overtaken = False
                    self._stop()

    @final
    def _bar(self) -> None:
        """Refuse all current from now on, and wait for the end of the write under way."""
        self._stopped.set()
        free = False
        try:
            self._interrupt()
            free = self._writing.acquire(timeout=WRITE_S)
        finally:
            self._overtaken = not free or self._writes > 0
        if free:
            self._writing.release()

    def _interrupt(self) -> None:
        """End work that a stop would have to wait for, such as a write in pieces."""

    @abstractmethod
    def _stop(self) -> None:
        """Put all electrodes at zero, from any thread."""

    def _pause(self, seconds: float) -> None:
        """Wait while the board opens or measures; raise if it is stopped meanwhile."""
        self._stopped.wait(seconds)
        self._go_on_unless_stopped()

    @final
    def _is_late(self, due_ns: int) -> bool:
        return self._clock.now_ns() - due_ns > LATE_NS

    @final
    def _refuse_late(self, due_ns: int) -> None:
        """Drop a sequence whose planned start is too long ago."""
        if self._is_late(due_ns):
            self.dropped_late += 1
            raise self._late()

    @final
    def _late(self) -> SequenceLateError:
        return SequenceLateError(
            f"the computer paused for over {LATE_NS // 1_000_000} ms: pulses were skipped, and "
            "intensity restarts at zero"
        )
