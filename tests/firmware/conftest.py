"""Boards of the firmware: processes of their own, behind a port whose name they print."""

import select
import subprocess

import pytest

from tests.firmware import build


@pytest.fixture
def start_firmware():
    """Return a starter of the C core behind a pseudo-terminal: the process and its port."""
    started = []

    def start(*arguments, electrodes=8, output="weighted"):
        options = (f"--electrodes={electrodes}", f"--output={output}", "--linger=2", *arguments)
        process = subprocess.Popen(
            [build.host(), *options], stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        started.append(process)
        assert select.select([process.stdout], [], [], 60)[0], "the firmware prints no port"
        return process, process.stdout.readline().strip()

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()
