"""Fixtures that start boards with the C firmware, each in a process of its own with a port."""

import select
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2]))  # last: an installed package has priority
pytest_plugins = ["tests.fixtures"]


@pytest.fixture
def start_firmware():
    """Return a function that starts the C core and returns its process and its port's name."""
    from firmware.tests.builds_and_machines import host
    from tests.support.processes import share_priority

    started = []

    def start(*arguments, electrodes=8, output="weighted"):
        options = (f"--electrodes={electrodes}", f"--output={output}", "--linger=2", *arguments)
        process = subprocess.Popen(
            [host(), *options],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        share_priority(process.pid)
        assert select.select([process.stdout], [], [], 60)[0], "the firmware prints no port"
        return process, process.stdout.readline().strip()

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture
def start_cortex_m3(tmp_path):
    """Return a function that starts the firmware on an emulated Cortex-M3 (`CortexM3`)."""
    from firmware.tests.builds_and_machines import CortexM3

    started = []

    def start(folder=tmp_path, **what):
        started.append(CortexM3(folder, **what))
        return started[-1]

    yield start
    for machine in started:
        machine.close()
