"""Functions for programs: run, step through, and replay."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from smarttouch.base.stopping import StopRequest
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.profile import Profile, load_profile
from smarttouch.running.config import RunConfig, configured
from smarttouch.running.display import Display, open_display
from smarttouch.running.listener import Listener, as_listeners
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.recorded_source import RecordedControls, RecordingSource
from smarttouch.running.recording import Recording
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.runner import Runner
from smarttouch.running.step import Step, StepResult
from smarttouch.sources import open_source, options_taken
from smarttouch.sources.force import ForceSource
from smarttouch.sources.given_sources import Given, Imaging, OwnImaging, checked_input, source_of
from smarttouch.sources.source_contract import Source

Listeners = Iterable[Listener | Callable[[StepResult], object]]


def run(
    source: Given,
    display: Display | str,
    config: RunConfig | None = None,
    *,
    listeners: Listeners = (),
    force: ForceSource | str | None = None,
    imaging: Imaging | None = None,
    stop: StopRequest | None = None,
    **settings: Any,
) -> RunStatistics:
    """Run a source on a display until the source ends, or `Display.stop` ends the run.

    Parameters
    ----------
    source : Source, str, Path, ndarray or iterable
        A source, closed at the end; or its URL; the path of an image, document, video or recording;
        images (N, H, W) uint8; or an iterable of images, one for each sequence.
    display : Display or str
        A display, or the URL of its board.
    config : RunConfig, optional
        Settings of the run.
    listeners : iterable of Listener or callable
        Follow the run; a plain function is given each `StepResult`.
    force : ForceSource or str, optional
        Finger force, or its URL. On boards that a finger may be on, it must be measured by the
        source, the board or this, or be stated (``"fixed:0.9"``, also as the profile's
        ``force.source``); elsewhere that of the source or board if not given.
    imaging : callable, optional
        Function of a `Frame` and the electrodes that returns the activation of RA, SAI and PC at
        each, (3, E) in [0, 1], in place of binarization.
    stop : StopRequest, optional
        Ends the run from elsewhere; so does `Display.stop`.
    **settings
        Settings of `RunConfig` in place of those: ``mode``, ``seconds``, ``intensity`` …

    Returns
    -------
    RunStatistics

    Raises
    ------
    SmartTouchError
        Whatever keeps the run from beginning or going on; the display is at zero.

    Examples
    --------
    >>> import smarttouch as st
    >>> st.run("text:a", "simulated:", seconds=0.5).frames
    25
    """
    config = configured(config, settings)
    display = open_display(display) if isinstance(display, str) else display
    listeners = as_listeners(listeners)
    opened = _open(source, display.profile, config, listeners)
    if imaging is not None:
        opened = OwnImaging(opened, imaging, display.profile)
    return Runner(opened, display, config, force=force, listeners=listeners, stop=stop).run()


def _open(source: Given, profile: Profile, config: RunConfig, listeners: list[Listener]) -> Source:
    """Return the source of a run; it is told if a vibrator drives PC."""
    vibrated = any(each.vibrates_pc for each in listeners)
    if vibrated and isinstance(source, str) and "vibrated" in options_taken(source):
        return open_source(source, profile, vibrated=True)
    return source_of(source, profile, light_on_dark=config.light_on_dark)


def steps(
    source: Given,
    profile: Profile | str,
    config: RunConfig | None = None,
    *,
    kernels: KernelBank | None = None,
    **settings: Any,
) -> Iterator[Step]:
    """Yield each frame of a source with its tactile image and sequence: no board, no clock.

    Sequences are those for a board that keeps kernels, as ``emulator:`` and ``simulated:`` do.

    Parameters
    ----------
    source : Source, str, Path, ndarray or iterable
        See `run`.
    profile : Profile or str
        Device and finger, or the name or file of the profile.
    config : RunConfig, optional
        Settings of the run.
    kernels : KernelBank, optional
        Those of the profile if not given.
    **settings
        Settings of `RunConfig` in place of those; ``intensity`` is 1 if not given.

    Examples
    --------
    >>> import smarttouch as st
    >>> profile = st.load_profile("electric-mouse")
    >>> first = next(st.steps(st.open_source("text:a", profile), profile))
    >>> first.tactile.activation.shape
    (3, 64)
    """
    profile, config = load_profile(profile), configured(config, settings)
    level = 1.0 if config.intensity is None else config.intensity
    pipeline = Pipeline(profile, kernels or load_bank(profile), config, in_sums=True)
    most_ns = float("inf") if config.seconds is None else config.seconds * 1e9
    elapsed_ns = 0
    with source_of(source, profile, light_on_dark=config.light_on_dark) as opened:
        while elapsed_ns < most_ns and (given := opened.read(elapsed_ns)) is not None:
            frame = checked_input(given, opened, pipeline.electrodes)
            if frame.stale:
                frame = replace(frame, force_n=0.0)
            step = pipeline.process(frame, level)
            yield step
            elapsed_ns += 1000 * step.sequence.period_us


def replay(
    path: Path | str,
    display: Display,
    *,
    listeners: Listeners = (),
    force: ForceSource | str | None = None,
    stop: StopRequest | None = None,
    **settings: Any,
) -> RunStatistics:
    """Run what a recording holds on a display once more, with its modes and levels.

    Parameters
    ----------
    path : Path or str
        The recording.
    display : Display
        Its profile may be another than the recorded one. Where a finger may be on the board, the
        recording lowers its limits, never raises them, and the recorded force opens no current.
    listeners, force, stop
        See `run`.
    **settings
        Settings of `RunConfig` in place of the recorded ones; ``intensity`` is a part of the
        recorded.

    Raises
    ------
    RecordingError
        If there is no such recording, or the board does not offer its modes.
    SmartTouchError
        See `run`.

    Examples
    --------
    >>> import smarttouch as st, tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.mcap"
    >>> display = st.open_display("simulated:")
    >>> source = st.open_source("text:a", display.profile)
    >>> first = st.run(source, display, seconds=0.5, listeners=[st.Recorder(path)])
    >>> st.replay(path, display).slots == first.slots
    True
    """
    recording = Recording(path)
    source = RecordingSource(recording)
    source.url = f"recording:{path}"
    config = recording.run.model_copy(update={"hold": None, "balance": False} | dict(settings))
    controls = partial(RecordedControls, recording)
    return Runner(
        source, display, config, force=force, listeners=listeners, stop=stop,
        controls=controls,
    ).run()  # fmt: skip
