"""Errors for the user. A message says what is wrong, with its value, and what to do."""

import math
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Any, TypeVar

_Choice = TypeVar("_Choice", bound=str)


class SmartTouchError(Exception):
    """Base of every error this package raises on purpose.

    Parameters
    ----------
    message : str
        What is wrong, with its value, and what to do.
    slot, electrode : int or None
        Place of the problem, if it has one.
    """

    def __init__(
        self, message: str = "", *, slot: int | None = None, electrode: int | None = None
    ) -> None:
        super().__init__(message)
        self.slot: int | None = slot
        self.electrode: int | None = electrode


class TableError(SmartTouchError):
    """A file of keys and values cannot be found or read, or is not valid.

    Attributes
    ----------
    key : str
        The first wrong key; "" if the file as a whole is wrong.
    complaints : tuple of tuple
        Key and sentence of each wrong value.
    """

    def __init__(
        self,
        message: str = "",
        *,
        key: str = "",
        complaints: Sequence[tuple[str, str]] = (),
        **place: Any,
    ) -> None:
        super().__init__(message, **place)
        self.key: str = key
        self.complaints: tuple[tuple[str, str], ...] = tuple(complaints) or ((key, message),)


class ProfileError(TableError):
    """A profile cannot be found or read, or is not valid."""


class SourceError(SmartTouchError):
    """A source of frames, stimuli or force cannot be opened or has failed."""


class SourceLostError(SourceError):
    """A source was lost; it may come back."""


class PageError(SmartTouchError):
    """A page or document cannot be read, or has nothing to read."""


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
        Name of the limit.
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
        super().__init__(message, slot=slot, electrode=electrode)
        self.limit: str = limit
        self.value: float = value
        self.allowed: float = allowed


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
    name: str,
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
    raise error(f"{words or f'{name} {value:g}'} is out of range: give {allowed}")


def choice_of(
    name: str,
    text: str,
    choices: Iterable[_Choice],
    error: type[SmartTouchError] = SmartTouchError,
) -> _Choice:
    """Return the choice that a text is, in capitals or not."""
    known = list(choices)
    for known_name in known:
        if text.lower() == known_name.lower():
            return known_name
    raise error(f"{name} {text!r} is not offered: choose {' or '.join(known)}")


def kind_in_words(value: object) -> str:
    """Return what a value is: "a list", "an array of float32 (8, 8)"."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        return f"an array of {value.dtype} {value.shape}"
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"


def import_extra(
    module: str, what: str, extra: str, error: type[SmartTouchError] = SmartTouchError
) -> Any:
    """Import a module of an extra; raises an error that names the extra where it is missing."""
    try:
        return import_module(module)
    except ImportError:
        command = f"pip install 'smarttouch[{extra}]'"
        message = f"{what} needs the extra {extra}: {command}"
        raise error(message) from None
