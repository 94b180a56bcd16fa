"""Errors for the user. Each message has the subject, the number, and the remedy."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

_Choice = TypeVar("_Choice", bound=str)


class SmartTouchError(Exception):
    """Base of every error this package raises on purpose.

    The message is for people; programs and tests go by the type and these attributes.

    Parameters
    ----------
    message : str
        One sentence: what is wrong, which number, what to do.
    about : str
        Name of what is wrong: a parameter, a key of a profile, a limit, or "file", "port",
        "board" and the like.
    remedy : str
        The parameter, key or command that fixes it, and its value: "overwrite or output",
        "profile line-8".
    slot, electrode : int or None
        Place of the problem, if it has one.
    """

    def __init__(
        self,
        message: str = "",
        *,
        about: str = "",
        remedy: str = "",
        slot: int | None = None,
        electrode: int | None = None,
    ) -> None:
        super().__init__(message)
        self.about: str = about
        self.remedy: str = remedy
        self.slot: int | None = slot
        self.electrode: int | None = electrode


class TableError(SmartTouchError):
    """A file of keys and values cannot be found or read, or is not valid.

    Attributes
    ----------
    complaints : tuple of tuple
        Key and sentence of each thing that is wrong; ``about`` is the key of the first.
    """

    def __init__(
        self, message: str = "", *, complaints: Sequence[tuple[str, str]] = (), **attributes: Any
    ) -> None:
        super().__init__(message, **attributes)
        self.complaints: tuple[tuple[str, str], ...] | tuple[tuple[str, str]] = tuple(
            complaints
        ) or ((self.about, message),)


class ProfileError(TableError):
    """A profile cannot be found or read, or is not valid."""


class SourceError(SmartTouchError):
    """A source of frames, stimuli or force cannot be opened or has failed."""


class SourceLostError(SourceError):
    """A source was lost; it may come back."""


class PageError(SmartTouchError):
    """A page or document cannot be read, or has nothing to read."""


class UnknownSizeError(PageError):
    """The size of a page is unknown: give its resolution or width."""


class BrailleError(SmartTouchError):
    """A text cannot be put into Braille, or cells not into text."""


class ReadingError(SmartTouchError):
    """A text cannot be read with a fingertip, or not by machine."""


class ExperimentError(SmartTouchError):
    """An experiment cannot be run as asked, or its answers cannot be read."""


class LevelNotReachedError(SmartTouchError):
    """A level of intensity could not be opened, or was lost while a pattern was shown."""


class CalibrationError(SmartTouchError):
    """A calibration cannot be done, or its result is implausible."""


class DesignError(SmartTouchError):
    """No kernel exists for what was asked."""


class ScheduleError(SmartTouchError):
    """A tactile image cannot be turned into a scan sequence."""


class SafetyError(SmartTouchError):
    """A scan sequence breaks a limit; nothing of it was sent.

    Attributes
    ----------
    limit : str
        Name of the limit: what the error is about.
    value, allowed : float
        Requested and allowed value, in the limit's unit; NaN where neither is a
        number.
    """

    def __init__(
        self,
        message: str,
        *,
        limit: str = "",
        value: float = math.nan,
        allowed: float = math.nan,
        slot: int | None = None,
        electrode: int | None = None,
    ) -> None:
        super().__init__(message, about=limit, slot=slot, electrode=electrode)
        self.value: float = value
        self.allowed: float = allowed

    @property
    def limit(self) -> str:
        return self.about


class BoardError(SmartTouchError):
    """A board cannot be opened, refused a command, or is gone."""


class LineLostError(BoardError):
    """The line to a board broke, or it fell silent; a restart may help."""


class SilentBoardError(BoardError):
    """A board does not answer when it is opened; it may still be starting."""


class OtherDeviceError(BoardError):
    """Another device answers where a board was; it was sent a query and nothing else."""


class BoardRestartedError(BoardError):
    """A board was lost and is back, at zero: begin again at intensity 0."""


class SequenceLateError(BoardRestartedError):
    """A sequence was too late to be sent, and was dropped: begin again at intensity 0."""


class BoardFaultError(BoardError):
    """A board delivered current that was not sent, or contradicts itself: it is latched."""


class KernelTableError(BoardFaultError):
    """A board keeps other kernels than those that it was sent."""


class EmergencyStopError(BoardError):
    """The emergency switch of a board is open: close it, then begin again."""


class BoardLatchedError(BoardError):
    """A board is refused because of an earlier fault, until a person clears it."""


class BoardClosedError(BoardError):
    """A board is not open."""


class BoardStoppedError(BoardError):
    """A board was stopped, and is at zero: nothing is sent to it any more."""


class RecordingError(SmartTouchError):
    """A recording cannot be written or read."""


def require_within(
    error: type[SmartTouchError],
    about: str,
    value: float,
    least: float,
    most: float,
    words: str = "",
    *,
    above: bool = False,
) -> None:
    """Raise an error unless a number is in its range; NaN is in none.

    ``words`` is the number with its meaning and unit, for the sentence; ``above`` excludes
    ``least``.
    """
    if least <= value <= most and not (above and value == least):
        return
    allowed = f"above {least:g}, at most {most:g}" if above else f"{least:g} to {most:g}"
    if most == math.inf:
        allowed = f"a number above {least:g}" if above else f"{least:g} or more"
    message = f"{words or f'{about} {value:g}'} is out of range: give {allowed}"
    raise error(message, about=about)


def not_offered(
    about: str, value: str, names: Iterable[str], error: type[SmartTouchError] = SmartTouchError
) -> SmartTouchError:
    """Return the error of a parameter that names none of its choices."""
    message = f"{about} {value!r} is not offered: choose {' or '.join(names)}"
    return error(message, about=about)


def choice_of(
    about: str,
    text: str,
    choices: Iterable[_Choice],
    error: type[SmartTouchError] = SmartTouchError,
) -> _Choice:
    """Return the choice that a text is, in capitals or not."""
    known = list(choices)
    for each in known:
        if text.lower() == each.lower():
            return each
    raise not_offered(about, text, known)


def kind_in_words(value: object) -> str:
    """Return what a value is: "a list", "an array of float32 (8, 8)"."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        return f"an array of {value.dtype} {value.shape}"
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"


def require_made(made: object, error: type[SmartTouchError], about: str) -> None:
    """Raise if the class of an object of a program did not call its base's ``__init__``, which
    gives it ``notes``."""
    if not hasattr(made, "notes"):
        name = type(made).__name__
        raise error(
            f"{name} does not call super().__init__(): do so in its __init__, or in __post_init__ "
            "of a dataclass",
            about=about,
        )


def require_returned(
    owner: object, method: str, value: object, kind: type, wanted: str, error: type[SmartTouchError]
) -> None:
    """Raise if a method of a program's class returned something else than its contract asks."""
    if not isinstance(value, kind):
        raise error(
            f"{type(owner).__name__}.{method} returned {kind_in_words(value)}: return {wanted}",
            about=method,
        )


class DeprecatedNameWarning(DeprecationWarning):
    """A public name goes in a later version; the message says which, and what to use instead."""
