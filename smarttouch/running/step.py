"""One step of a run: what went in, what came out, and how it was sent."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.imaging.tactile_image import TactileImage
from smarttouch.primary import Mode
from smarttouch.sources.frame import Frame
from smarttouch.stimulation.sequence import ScanSequence

Measured = tuple[ScanSequence, NDArray[np.float32]]
"""A sequence that was delivered, and what its source needed in each slot, (S,) V."""


@dataclass(frozen=True, eq=False)
class Step:
    """One frame's way to a sequence, and all that it depended on.

    Attributes
    ----------
    frame : Frame
        With the force that counted.
    tactile : TactileImage
    sequence : ScanSequence
        As it is sent.
    mode : Mode
    level : float, in [0, 1]
        What the user asked for.
    restarted : bool
        Whether intensity began at zero here.
    asked_us : int, µs
        Period that was wanted; longer ones did not fit.
    observed : tuple of (ScanSequence, ndarray)
        What the board had measured until then, where sequences depend on it.
    """

    frame: Frame
    tactile: TactileImage
    sequence: ScanSequence
    mode: Mode
    level: float = 1.0
    restarted: bool = False
    asked_us: int = 0
    observed: tuple[Measured, ...] = ()


@dataclass(frozen=True, eq=False)
class StepResult:
    """One step, and how it was sent.

    Attributes
    ----------
    step : Step
    number : int or None
        The board's number of its sequence; None if the board was lost with it.
    latency_us : float
        From the frame in hand to the last byte written.
    work_us : float
        Processor time that it took the loop.
    acknowledged, refused : int
        Sequences that the board had begun to deliver, or declined, until then.

    Examples
    --------
    >>> import smarttouch as st
    >>> results, display = [], st.open_display("simulated:")
    >>> source = st.open_source("text:a", display.profile)
    >>> statistics = st.run(source, display, seconds=0.1, listeners=[results.append])
    >>> [result.number for result in results]
    [1, 2, 3, 4, 5]
    """

    step: Step
    number: int | None
    latency_us: float
    work_us: float = 0.0
    acknowledged: int = 0
    refused: int = 0

    @property
    def frame(self) -> Frame:
        """Frame that the step began with."""
        return self.step.frame

    @property
    def tactile(self) -> TactileImage:
        """Activation of each class at each electrode."""
        return self.step.tactile

    @property
    def sequence(self) -> ScanSequence:
        """Sequence that was sent."""
        return self.step.sequence
