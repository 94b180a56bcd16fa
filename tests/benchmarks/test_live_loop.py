"""The whole program for a minute: a video and a serial array to the emulator.

Run with::

    pytest tests/benchmarks/test_live_loop.py --benchmark-only -n0

Each source with the other core free and kept busy. Frames in, delivered and dropped; from the
taking of an image to the last byte and to the first pulse; how far periods were off; memory after a
sixth of the time and at the end; the loop's own work beside the time that the board scans.
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from smarttouch.base.files import data_folder
from smarttouch.pages.document import open_document
from smarttouch.profile import load_profile
from smarttouch.sources.virtual_finger import PageSource

CYCLE = 150
"""Frames of the video before it begins again."""
PROGRAM = Path(sys.executable).with_name("smarttouch")


def make_video(path, seconds, rate_hz):
    """A finger that reads the sample page, 640 x 480, as a camera takes it."""
    profile = load_profile("electric-mouse")
    optics = profile.optics.model_copy(update={"sensor_columns": 640, "sensor_rows": 480})
    page = open_document(data_folder("sample_images") / "page.png").page(0)
    sensor = PageSource(page, profile.model_copy(update={"optics": optics}), "a page")
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate_hz, (640, 480), False)
    images = [sensor.read(int(step / rate_hz * 1e9)).image for step in range(CYCLE)]
    for step in range(int((seconds + 2) * rate_hz)):
        writer.write(images[step % CYCLE])
    writer.release()


@contextlib.contextmanager
def array():
    """A process that plays a 64 x 64 serial array at 200 frames/s; its port."""
    command = [sys.executable, "-m", "smarttouch.emulator", "serial-array?linger=2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


def resident_mib(process):
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return float("nan")


def figures(sensor, folder, seconds):
    """Run the program; return its figures, and its memory early and at the end."""
    out = folder / "run.json"
    command = [PROGRAM, "live", sensor, "--board", "emulator:", "--force", "fixed:0.9"]
    command += ["--seconds", f"{seconds:g}", "--json", str(out)]
    memory = []
    with subprocess.Popen(command) as process:
        while process.poll() is None:
            with contextlib.suppress(OSError):
                memory.append((time.monotonic(), resident_mib(process.pid)))
            time.sleep(0.2)
    assert process.returncode == 0
    moments = np.array([at for at, _ in memory])
    early = int(np.searchsorted(moments, moments[-1] - seconds * 5 / 6))
    return json.loads(out.read_text()), memory[early][1], memory[-5][1]


@pytest.mark.timeout(0)
def test_live(row, quick, hog, tmp_path):
    seconds = 1.2 if quick else float(os.environ.get("SMARTTOUCH_LIVE_SECONDS", "60"))
    videos = {rate_hz: tmp_path / f"{rate_hz}.avi" for rate_hz in (30, 120)}
    for rate_hz, video in videos.items():
        make_video(video, seconds, rate_hz)
    rows = []
    for busy in (False, True):
        if not (quick and busy):
            with hog(busy):
                for rate_hz, video in videos.items():
                    found = figures(f"video:{video}", tmp_path, seconds)
                    rows.append((f"video, {rate_hz} a second", busy, *found))
        if quick and not busy:
            continue
        with hog(busy), array() as port:
            rows.append(("array", busy, *figures(f"serial-array:{port}", tmp_path, seconds)))
    for name, busy, found, early, late in rows:
        ms = [found["motion_to_bytes_us"][key] / 1e3 for key in ("p50", "p99", "max")]
        pulse_ms = [found["motion_to_pulse_us"][key] / 1e3 for key in ("p50", "p99", "max")]
        error = found["period_error_us"]
        row(
            f"The whole program, {seconds:g} s each",
            {
                "sensor": name + ", a core busy" * busy,
                "frames in": found["frames_in"],
                "delivered + dropped": f"{found['frames_delivered']} + {found['dropped_frames']}",
                "sequences": found["sequences"],
                "image to last byte, ms, p50 / p99 / max": " / ".join(f"{at:.1f}" for at in ms),
                "to first pulse, ms": " / ".join(f"{at:.1f}" for at in pulse_ms),
                "period off by, µs, p50 / p99 / max": (
                    f"{error['p50']:.0f} / {error['p99']:.0f} / {error['max']:.0f}"
                ),
                "work, µs, p50 / p99": (
                    f"{found['work_us']['p50']:.0f} / {found['work_us']['p99']:.0f}"
                ),
                "work, of the scans": f"{found['work_share']:.2%}",
                "memory, MiB": f"{early:.1f} → {late:.1f}",
                "restarts": found["restarts"],
            },
        )
        assert found["frames_in"] == found["frames_delivered"] + found["dropped_frames"] > 0
        assert found["emulator_violations"] == 0
        if not quick:
            assert late < early * 1.05 + 1
