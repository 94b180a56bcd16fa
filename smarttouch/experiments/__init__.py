"""Psychophysics, calibration, and studies of many simulated fingers.

What an experiment of one's own is made of, for ``smarttouch experiment run mine.py`` and the
entry points ``smarttouch.experiments``, can be imported from here.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from smarttouch.experiments.psychophysics.catalog import (
        Design,
        Experiment,
        ExperimentOptions,
    )
    from smarttouch.experiments.psychophysics.procedures import (
        Condition,
        ConstantStimuli,
        Procedure,
    )
    from smarttouch.experiments.psychophysics.tasks import in_two_intervals
    from smarttouch.experiments.psychophysics.trials import Stimuli, Task, Train, Trial

__all__ = [
    "Condition",
    "ConstantStimuli",
    "Design",
    "Experiment",
    "ExperimentOptions",
    "Procedure",
    "Stimuli",
    "Task",
    "Train",
    "Trial",
    "in_two_intervals",
]

_WHERE = {
    "catalog": ("Design", "Experiment", "ExperimentOptions"),
    "procedures": ("Condition", "ConstantStimuli", "Procedure"),
    "tasks": ("in_two_intervals",),
    "trials": ("Stimuli", "Task", "Train", "Trial"),
}
_MODULE = {name: module for module, names in _WHERE.items() for name in names}

if not TYPE_CHECKING:  # else any name would be one to a type checker

    def __getattr__(name: str) -> Any:
        """Import a name when it is used first."""
        if name not in _MODULE:
            raise AttributeError(f"module 'smarttouch.experiments' has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.psychophysics.{_MODULE[name]}"), name)
