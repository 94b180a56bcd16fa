"""Small sequences, and boards to send them to."""

import select
import subprocess
import sys

import numpy as np
import pytest

from smarttouch.scan.safety import SafetyLimits
from smarttouch.scan.sequence import ScanSequence

SECOND = 10**9


@pytest.fixture(scope="session")
def make_limits():
    """Return a maker of limits for some number of electrodes."""

    def make(electrodes=8):
        return SafetyLimits(
            electrodes=electrodes,
            current_ma=3.0,
            pulse_us=200,
            charge_uc=0.5,
            rate_hz=100,
            duty=0.6,
            ramp_s=0.5,
            full_ma=2.4,
        )

    return make


@pytest.fixture(scope="session")
def make_sequence():
    """Return a maker of balanced sequences: one cathode against all others in each slot."""

    def make(step=1, *, electrodes=8, slots=4, period_us=10_000, level_ua=700, **other):
        site = np.arange(slots, dtype=np.uint16) % electrodes
        current = np.full((slots, electrodes), -level_ua // (electrodes - 1), np.int16)
        current[np.arange(slots), site] = 0
        current[np.arange(slots), site] = -current.sum(axis=1)
        if step == 0:
            current, site = current[:0], site[:0]
        fields = {
            "current_ua": current,
            "width_us": np.full(len(site), 100, np.uint16),
            "discharge_us": np.full(len(site), 50, np.uint16),
            "site": site,
            "period_us": period_us,
            # The first of a run is silent, and each is a second after the one before.
            "intensity": float(step > 0),
            "time_ns": step * SECOND,
        }
        return ScanSequence(**(fields | other))

    return make


@pytest.fixture
def start_emulator():
    """Return a starter of emulator processes by hand: the process and its port."""
    started = []

    def start(*arguments, electrodes=8, output="weighted"):
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "smarttouch.boards.emulator",
                f"--electrodes={electrodes}",
                f"--output={output}",
                *arguments,
            ],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        assert select.select([process.stdout], [], [], 20)[0], "the emulator prints no port"
        return process, process.stdout.readline().strip()

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()
