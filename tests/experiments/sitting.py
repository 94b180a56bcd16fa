"""A whole experiment on a simulated board, answered by observers of known thresholds."""

from dataclasses import dataclass, field

import numpy as np

from smarttouch.base.stopping import StopRequest
from smarttouch.experiments.experiment_session import open_experiment
from smarttouch.experiments.trial_source import TrialSource
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.inputs import Controls
from smarttouch.running.runner import Runner
from smarttouch.running.step import OnEvent, OnStep


@dataclass
class Perfect:
    """Measures the time between pulses, counts them, and keeps what it felt."""

    felt: list = field(default_factory=list)

    def respond(self, task, intervals, alternatives):
        self.felt.append((task, intervals))
        pulses = [len(each.time_s) for each in intervals]
        if task == "faster":
            return str(1 + int(np.argmin([np.diff(each.time_s).mean() for each in intervals])))
        if len(intervals) == 2:
            return str(1 + int(np.argmax(pulses)))
        return "y" if pulses[0] else "n"


class Silent:
    """Never answers."""

    def respond(self, task, intervals, alternatives):
        return None


@dataclass
class Sat:
    """Result of a run."""

    source: TrialSource
    rows: list
    over: bool
    resumed: int
    told: list
    figures: dict

    def events(self, start):
        """Return the events that begin so."""
        return [words for _, words in self.told if words.startswith(start)]


def sit(name, setup, bank, path, observer, *, stop_after=None, watch=None, controls=None):
    """Run an experiment; stop it before the answer of a trial is written if asked to."""
    stop, told = StopRequest(), []
    with open_experiment(name, setup, path, "p1", "s1") as sitting:
        source = sitting.source(observer)

        def observe(sent):
            if watch is not None:
                watch(sent, source, controls)
            playing = source.title.endswith(("first", "second", "feel"))
            if stop_after is not None and len(sitting.file.rows) >= stop_after and playing:
                stop.ask("killed")

        statistics = Runner(
            source,
            Display("simulated:", setup.profile),
            RunConfig(scan="points"),
            listeners=[
                OnStep(observe),
                OnEvent(lambda event: told.append((event.time_ns, str(event)))),
            ],
            stop=stop,
            load_kernels=lambda _profile: bank,
            controls=Controls if controls is None else lambda _state, _modes: controls,
        ).run()
        return Sat(source, sitting.file.rows, sitting.over, sitting.resumed, told,
                   statistics.figures)  # fmt: skip
