"""Responses of the receptors under the electrodes to delivered pulses."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.profile.device import Pulse
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Pose

Floats = NDArray[np.float32]


class DeliveredResponses:
    """Poses of the sequences of a run and, after it, the responses to them.

    Each delivered slot activates the receptors under all electrodes by the activating function at
    their nodes; a response counts from the detection threshold on, and is 1 at the strongest
    comfortable pulse. Of several classes the strongest response counts. Iterating yields pose and
    response, (E,) in [0, 1], of each sequence delivered while the finger touched.
    """

    def __init__(self, profile: Profile, bank: KernelBank, afferents: tuple[Afferent, ...]) -> None:
        self.poses: dict[int, Pose] = {}
        self.period_us: dict[int, int] = {}
        self.answer: dict[int, Floats] = {}
        self._silent = np.zeros(len(profile.electrodes), np.float32)
        self._pulse = profile.pulse
        full_ua = profile.full_ma * 1000
        self._receptors = []
        for afferent in afferents:
            receptor = bank.receptor[afferent]
            full = full_ua * (receptor * bank.kernels(afferent)).sum(axis=1)
            # Masked sites have no kernel: there is no response.
            self._receptors.append((receptor.T, np.where(full > 0, full, np.inf)))
        self._threshold = profile.threshold_ma / profile.full_ma

    def watch(self, sent: StepResult) -> None:
        """Record the pose of a step, and its duration."""
        if sent.number is not None and sent.sequence.intensity > 0:
            self.poses[sent.number] = sent.input.pose
            self.period_us[sent.number] = sent.sequence.period_us

    def deliver(
        self, numbers: NDArray[np.uint32], width_us: Floats, current_ua: NDArray[np.int16]
    ) -> None:
        """Take delivered slots. Slots of one sequence, by ``numbers`` (N,), follow each other, with
        their ``width_us`` (N,) and ``current_ua`` (N, E), positive cathodic."""
        if not len(numbers):
            return
        current = current_ua * strength(width_us, self._pulse)[:, None]
        activation = np.maximum.reduce([current @ axons / full for axons, full in self._receptors])
        answers = np.clip((activation - self._threshold) / (1 - self._threshold), 0, 1)
        starts = np.flatnonzero(np.diff(numbers.astype(np.int64), prepend=-1))
        strongest = np.maximum.reduceat(answers, starts, axis=0)
        self.answer = dict(zip(numbers[starts].tolist(), strongest, strict=True))

    def __iter__(self) -> Iterator[tuple[Pose, Floats]]:
        for number, pose in self.poses.items():
            yield pose, self.answer.get(number, self._silent)


def strength(width_us: Floats, pulse: Pulse) -> Floats:
    """Return the effect of pulses of given widths, (N,), relative to the profile's full pulse, by
    Weiss's law."""
    chronaxie_us = pulse.chronaxie_us
    full = 1 + chronaxie_us / pulse.width_us
    return np.asarray(full / (1 + chronaxie_us / np.maximum(width_us, 1)), np.float32)
