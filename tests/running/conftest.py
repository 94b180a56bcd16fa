"""Fixtures: steps of a pipeline, and recordings of these steps."""

from dataclasses import asdict, replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from smarttouch.base.events import Note
from smarttouch.running import recorder as writer_module
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.recorder import Recorder
from smarttouch.running.recording_format import about_run, digest_of
from smarttouch.running.step_records import StepResult
from smarttouch.sources.source_contract import Frame, Pose
from smarttouch.stimulation.scan_sequence import ScanTiming

STARTED_NS = 1_700_000_000 * 10**9


@pytest.fixture(scope="session")
def goldens():
    """Return the paths of all recordings in ``tests/running/goldens``."""
    found = sorted((Path(__file__).parent / "goldens").glob("*.mcap"))
    assert len(found) >= 4
    return found


@pytest.fixture(scope="session")
def golden(goldens):
    """Return a function that finds a golden recording by its name."""
    return {path.stem: path for path in goldens}.__getitem__


@pytest.fixture
def cut(recording, tmp_path):
    """Return the path of a copy of ``recording`` without the last 3000 bytes."""
    path = tmp_path / "cut.mcap"
    path.write_bytes(recording.read_bytes()[:-3000])
    return path


@pytest.fixture(scope="session")
def settings():
    """Return the settings of a run in mode RA, as recordings store them."""
    return {
        "mode": "RA", "rate_hz": None, "light_on_dark": False, "softness": None, "hold": None,
        "balance": False, "timing": asdict(ScanTiming()), "compliance_v": None,
        "subject": "S7", "sensor": "bars", "board": "memory:",
    }  # fmt: skip


@pytest.fixture(scope="session")
def about(profile, settings):
    return about_run(profile, settings, STARTED_NS)


@pytest.fixture(scope="session")
def make_steps(profile, bank):
    """Return a function that makes steps of a moving bar; each image is in two successive steps."""

    def make(count, period_ns=20_000_000):
        pipeline, rng = Pipeline(profile, bank, RunConfig(scan="points")), np.random.default_rng(1)
        made = []
        for index in range(count):
            if index % 2 == 0:
                image = np.full((64, 64), 215, np.uint8)
                image[:, (first := index % 50) : first + 12] = 30
                image += rng.integers(0, 6, image.shape, np.uint8)
            frame = Frame(image, index * period_ns, Pose(0.1 * index, 2.0), 1 / 3, index // 2)
            made.append(StepResult(pipeline.process(frame), index + 1, 99.5, 12.25))
        return made

    return make


@pytest.fixture(scope="session")
def steps(make_steps):
    return make_steps(40)


@pytest.fixture(scope="session")
def record(about):
    """Return a function that writes steps and events to a recording."""

    def write(path, steps, events=(), about=about):
        recorder = Recorder(path)
        recorder.begin(about | {"digest": digest_of(about)}, STARTED_NS)
        for words in events:
            recorder.event(Note(5_000_000, words))
        for sent in steps:
            recorder.step(replace(sent, acknowledged=(sent.number or 1) - 1))
        recorder.close()
        return path

    return write


@pytest.fixture(scope="session")
def recording(record, steps, tmp_path_factory):
    """Return the path of a short recording with many chunks."""
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    with pytest.MonkeyPatch.context() as patch:
        # With a chunk time of 0 s, each step and each event is a chunk of its own.
        patch.setattr(writer_module, "CHUNK_S", 0.0)
        return record(path, steps, ["paused", "goes on"])


@pytest.fixture(scope="session")
def damaged(recording):
    """Return the bytes of ``recording`` with one flipped bit, in the middle of its middle chunk."""
    content = bytearray(recording.read_bytes())
    chunks = make_reader(BytesIO(content)).get_summary().chunk_indexes
    middle = chunks[len(chunks) // 2]
    content[middle.chunk_start_offset + middle.chunk_length // 2] ^= 1
    return content
