"""Errors for the user. Messages state what is wrong, with the value, and what to do."""

import math
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Any, TypeVar

_Choice = TypeVar("_Choice", bound=str)


class SmartTouchError(Exception):
    """Base of all errors that this package raises on purpose.

    Parameters
    ----------
    message : str
        What is wrong, with the value, and what to do.
    slot, electrode : int or None
        Slot and electrode that the problem concerns, if any.
    """

    def __init__(
        self, message: str = "", *, slot: int | None = None, electrode: int | None = None
    ) -> None:
        super().__init__(message)
        self.slot: int | None = slot
        self.electrode: int | None = electrode


class TableError(SmartTouchError):
    """A TOML file cannot be found or read, or is invalid.

    Attributes
    ----------
    key : str
        Key of the first wrong value; "" if the error concerns the whole file.
    complaints : tuple of tuple
        For each wrong value, its key and a sentence that says what is wrong.
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
    """A profile cannot be found or read, or is invalid."""


class SourceError(SmartTouchError):
    """A source of frames, stimuli or force cannot be opened or has failed."""


class SourceLostError(SourceError):
    """The connection to a source was lost. The source can be plugged in again."""


class PageError(SmartTouchError):
    """A page or document cannot be read, or is empty."""


class BrailleError(SmartTouchError):
    """A text cannot be translated to Braille, or cells cannot be translated to text."""


class ReadingError(SmartTouchError):
    """A text cannot be presented to a fingertip, or text in an image cannot be recognized."""


class ExperimentError(SmartTouchError):
    """An experiment cannot be run with these options, or its answers cannot be read."""


class LevelNotReachedError(SmartTouchError):
    """The ramp did not reach the requested intensity, or intensity fell during a pattern."""


class CalibrationError(SmartTouchError):
    """A calibration is not possible, or its result is implausible."""


class DesignError(SmartTouchError):
    """The requested kernel or fiber model does not exist or cannot be designed."""


class ScheduleError(SmartTouchError):
    """A tactile image cannot be converted to a scan sequence."""


class SafetyError(SmartTouchError):
    """A scan sequence exceeds a limit; nothing was sent.

    Attributes
    ----------
    limit : str
        Name of the limit.
    value, allowed : float
        Requested and allowed value, in the unit of the limit; NaN if the limit has no numbers.
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
    """A board cannot be opened, has refused a command, or has been lost."""


class LineLostError(BoardError):
    """The connection to a board was lost, or the board stopped responding: restart the board."""


class SilentBoardError(BoardError):
    """A board does not respond when it is opened; it may still be starting."""


class OtherDeviceError(BoardError):
    """The device at a port is not the expected board; at most a query was sent to it."""


class BoardRestartedError(BoardError):
    """A board was lost and has reconnected, without current: start again at intensity 0."""


class SequenceLateError(BoardRestartedError):
    """A sequence was late and was dropped: start again at intensity 0."""


class BoardFaultError(BoardError):
    """A board delivered current that was not requested, or its reports are contradictory. A fault
    latch keeps the board closed until a person clears the fault."""


class EmergencyStopError(BoardError):
    """The emergency switch of a board is open: close it, then start again."""


class BoardLatchedError(BoardError):
    """A board cannot be opened because of an earlier fault, until a person clears the fault."""


class BoardClosedError(BoardError):
    """A board is not open."""


class BoardStoppedError(BoardError):
    """A board was stopped and is at zero; it accepts no more sequences."""


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
    """Raise an error unless a number is within a range. NaN is outside every range.

    ``words`` replaces name and value in the message. If ``above``, value must exceed ``least``.
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
    """Return the choice that equals a text, ignoring case; raise ``error`` if there is none."""
    known = list(choices)
    for known_name in known:
        if text.lower() == known_name.lower():
            return known_name
    raise error(f"{name} {text!r} is unknown: choose {' or '.join(known)}")


def kind_in_words(value: object) -> str:
    """Return the type of a value in words: "a list", "an array of float32 (8, 8)"."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        return f"an array of {value.dtype} {value.shape}"
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"


def import_extra(
    module: str, what: str, extra: str, error: type[SmartTouchError] = SmartTouchError
) -> Any:
    """Import a module of an extra; if it is missing, raise an error with the pip command."""
    try:
        return import_module(module)
    except ImportError:
        command = f"pip install 'smarttouch[{extra}]'"
        message = f"{what} needs the extra {extra}: {command}"
        raise error(message) from None
