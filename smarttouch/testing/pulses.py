"""Pulses of a device, to compare what it was sent with what was proved."""

import sys
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np

from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.stimulation.scan_sequence import ScanSequence

LOCKED_S = 0.02  # delay of a driver's line: an action not through by then waits for its lock


@dataclass(frozen=True)
class SentPulse:
    """One pulse that a device was sent, or `ZERO`, where all electrodes are put at zero.

    Attributes
    ----------
    current_ua : tuple of float, µA
        Of each electrode, positive cathodic.
    width_us : float, µs
    discharge_us, period_us : float, optional, µs
        For how long all electrodes are shorted after it, and how long a pass of its sequence
        takes; None where the device is not sent this, but has its own.
    """

    current_ua: tuple[float, ...]
    width_us: float
    discharge_us: float | None = None
    period_us: float | None = None


ZERO = SentPulse((), 0.0)  # all electrodes are shorted, and what was sent before is forgotten


def planned_pulses(sequence: ScanSequence, times: int) -> list[SentPulse]:
    """Return the pulses of all passes of a sequence, with its recharge phase as one of them."""
    period_us = float(sequence.period_us)
    one_pass = [
        SentPulse(tuple(map(float, current_ua)), float(width_us), float(discharge_us), period_us)
        for current_ua, width_us, discharge_us in zip(
            sequence.current_ua, sequence.width_us, sequence.discharge_us, strict=True
        )
    ]
    if sequence.recharge_ua is not None:
        current_ua = tuple(map(float, sequence.recharge_ua))
        one_pass.append(SentPulse(current_ua, float(sequence.recharge_us), None, period_us))
    return one_pass * times


def assert_same_pulses(
    found: Iterable[SentPulse], wanted: Iterable[SentPulse], step_ua: float, step_us: float
) -> None:
    """Fail unless pulses are those that were planned, each rounded to the device's steps."""
    found, wanted = list(found), list(wanted)
    assert len(found) == len(wanted), f"{len(found)} pulses where {len(wanted)} were proved"
    for number, (pulse, plan) in enumerate(zip(found, wanted, strict=True)):
        which = f"pulse {number} of {len(wanted)}: "
        for name, step in (
            ("current_ua", step_ua),
            ("width_us", step_us),
            ("discharge_us", step_us),
            ("period_us", step_us),
        ):
            flows, proved = getattr(pulse, name), getattr(plan, name)
            if flows is not None and proved is not None:
                atol = step / 2 + 1e-6
                message = which + name
                np.testing.assert_allclose(flows, proved, rtol=0, atol=atol, err_msg=message)


class AtLine:
    """Context in which an action is started, in a thread of its own, at one line of a driver's
    code: the one with this number, from 0, of those that its package executes, without `Board`
    itself."""

    thread: threading.Thread | None

    def __init__(self, board: Board, number: int, action: Callable[[], object]) -> None:
        kinds = [kind for kind in type(board.driver).__mro__ if issubclass(kind, Driver)]
        self._packages = {_package(kind.__module__) for kind in kinds if kind is not Driver}
        self._number, self._action = number, action
        self.lines: int = 0  # that were executed
        self.thread = None  # the action's, once it has started

    def __enter__(self) -> "AtLine":
        self._before = sys.gettrace()
        sys.settrace(self._enter)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(self._before)

    def _enter(self, frame: FrameType, event: str, argument: Any) -> Any:
        name = frame.f_globals.get("__name__", "")
        counts = name != Board.__module__ and _package(name) in self._packages
        return self._count if counts else None

    def _count(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "line":
            if self.lines == self._number:
                self.thread = threading.Thread(target=self._action)
                self.thread.start()
                # A driver that holds its lock here lets it through later.
                self.thread.join(LOCKED_S)
            self.lines += 1
        return self._count


def _package(module: str) -> str:
    """Return the package of a module; of those of SmartTouch the room, all drivers' parts."""
    if module.startswith("smarttouch."):
        return ".".join(module.split(".")[:2])
    return module.rpartition(".")[0] or module
