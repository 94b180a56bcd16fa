"""A whole experiment on a simulated board, answered by observers of known thresholds."""

from dataclasses import dataclass, field

import numpy as np

from smarttouch.base.afferent import Mode
from smarttouch.base.stopping import StopRequest
from smarttouch.experiments.psychophysics.experiment_session import TrialSession
from smarttouch.experiments.psychophysics.experiment_source import ExperimentSource
from smarttouch.experiments.psychophysics.simulated_subject import Subject
from smarttouch.experiments.psychophysics.trial_rows import About, RowFile
from smarttouch.experiments.psychophysics.trials import TrialTiming
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.runner import Runner
from smarttouch.running.step import OnEvent, OnStep

DATE = "2026-01-01T00:00:00+00:00"


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


@dataclass
class Sat:
    """Result of a run."""

    source: ExperimentSource
    session: TrialSession
    told: list
    figures: dict


def sit(
    made,
    profile,
    bank,
    path,
    observer,
    *,
    stop_after=None,
    experiment="frequency-RA",
    course=None,
    watch=None,
    controls=None,
):
    """Run an experiment; stop it before the answer of a trial is written if asked to."""
    stop, told = StopRequest(), []
    about = About(experiment, made.method, "p1", "s1", 0)
    display = Display("simulated:", profile)
    with RowFile(path, about) as file:
        session = TrialSession(made, file, DATE)
        source = ExperimentSource(session, profile, course or TrialTiming())
        controls = controls or Controls(ControlState(Mode.RA))

        def observe(sent):
            if watch is not None:
                watch(sent, source, controls)
            if stop_after is not None and session.done >= stop_after and source.playing:
                stop.ask("killed")

        events = OnEvent(lambda event: told.append((event.time_ns, str(event))))
        statistics = Runner(
            source,
            display,
            RunConfig(mode=Mode.RA, scan="points"),
            listeners=[Subject(source, observer), OnStep(observe), events],
            stop=stop,
            load_kernels=lambda _profile: bank,
            controls=lambda _state, _modes: controls,
        ).run()
    return Sat(source, session, told, statistics.figures)
