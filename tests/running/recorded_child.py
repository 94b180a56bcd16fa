"""A program that records until it is killed, or until its disk is full: ``recorded_child.py PATH
[BYTES]``.

After every step that it handed over it tells the time of the step in ns and 0, and after every
chunk 0 and how many steps the system has been given.
"""

import os
import resource
import sys
import time
from dataclasses import asdict

import numpy as np

from smarttouch.base.errors import RecordingError
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.recorder import Recorder
from smarttouch.running.recording_format import about_run
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Frame, Pose
from smarttouch.stimulation.pulse_rates import ScanTiming

PERIOD_NS = 10_000_000


def main(path, most_bytes=None):
    profile = load_profile("electric-mouse")
    pipeline = Pipeline(profile, load_bank(profile), RunConfig(scan="points"))
    pipeline.warm_up()
    rng = np.random.default_rng(0)
    images = [rng.integers(190, 220, (64, 64), np.uint8) for _ in range(16)]
    for index, image in enumerate(images):
        image[:, index : index + 20] = 20
    settings = {
        "mode": "RA", "rate_hz": None, "light_on_dark": False, "softness": None, "hold": None,
        "balance": False, "timing": asdict(ScanTiming()), "compliance_v": None,
    }  # fmt: skip
    if most_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(most_bytes),) * 2)
    started_unix_ns = time.time_ns()
    recorder = Recorder(path)
    recorder.begin(about_run(profile, settings, started_unix_ns), started_unix_ns)
    fsync = os.fsync

    def sync_and_tell(number):
        fsync(number)
        os.write(1, f"0 {recorder._steps}\n".encode())

    os.fsync = sync_and_tell
    start_ns = time.perf_counter_ns()
    deadline_ns = start_ns
    for index in range(6000):
        time.sleep(max(0, deadline_ns - time.perf_counter_ns()) / 1e9)
        # As the loop does: late it never hurries, and what it wrote meanwhile can be flushed.
        deadline_ns = max(deadline_ns, time.perf_counter_ns()) + PERIOD_NS
        time_ns = time.perf_counter_ns() - start_ns
        frame = Frame(images[index % 16], time_ns, Pose(0.0, 0.0), 1.0, index)
        try:
            recorder.step(StepResult(pipeline.process(frame), index, 0.0, acknowledged=index))
        except RecordingError as error:
            print(error)
            recorder.close()
            print("closed")
            return
        os.write(1, f"{time_ns} 0\n".encode())


if __name__ == "__main__":
    main(*sys.argv[1:])
