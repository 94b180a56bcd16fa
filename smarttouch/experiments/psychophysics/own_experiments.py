"""Experiments of a user's file or of another package; what fails in them is one sentence."""

import runpy
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from smarttouch.base.errors import ExperimentError, SmartTouchError
from smarttouch.base.files import require_file
from smarttouch.base.registry import load_plug_in
from smarttouch.experiments.psychophysics.procedures import Condition
from smarttouch.experiments.psychophysics.trials import Task, Trial

GROUP = "smarttouch.experiments"
"""Entry points of other packages: each names an `Experiment`."""
_MOST_BYTES = 10_000_000
_T = TypeVar("_T")


def load_own(name: str, kind: type[_T]) -> _T | None:
    """Return the experiment of a file ``NAME.py`` or an entry point; None if there is neither."""
    if not name.endswith(".py"):
        return load_plug_in(GROUP, name, ExperimentError, kind)
    require_file(Path(name), ExperimentError, _MOST_BYTES)
    found = called(name, runpy.run_path, dict, name)
    made = {id(each): each for each in found.values() if isinstance(each, kind)}
    if len(made) != 1:
        raise ExperimentError(
            f"{name} has {len(made) or 'no'} {kind.__name__}{'s' * (len(made) > 1)}: make one, as "
            "in experiment = Experiment('what it asks', make)",
            about="experiment",
        )
    return next(iter(made.values()))


def called(name: str, function: Callable[..., object], kind: type[_T], *arguments: object) -> _T:
    """Return what a function of an experiment returns; an ExperimentError if it fails or that is
    of another type."""
    try:
        given = function(*arguments)
    except SmartTouchError:
        raise
    except Exception as error:
        raise ExperimentError(
            f"{name} fails{_line_of(error)}: {type(error).__name__}: {error}", about="experiment"
        ) from error
    if not isinstance(given, kind):
        raise ExperimentError(
            f"{name}: {getattr(function, '__qualname__', 'it')} returned {type(given).__name__}: "
            f"it must return a {kind.__name__}",
            about="experiment",
        )
    return given


def _line_of(error: BaseException) -> str:
    """Return where code outside of this package failed, in words; empty if nowhere."""
    if isinstance(error, SyntaxError):
        return f" in line {error.lineno}"
    own = str(Path(__file__).parents[2])
    outside = [
        each.lineno
        for each in traceback.extract_tb(error.__traceback__)
        if not each.filename.startswith((own, "<frozen"))
    ]
    return f" in line {outside[-1]}" if outside else ""


class OwnTask:
    """Task of a user, whose trials are checked."""

    def __init__(self, task: Task, name: str) -> None:
        self._task, self._name = task, name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._task, name)

    def trial(self, condition: Condition) -> Trial:
        """Return the stimuli and the question of a condition."""
        return called(self._name, self._task.trial, Trial, condition)
