"""No forged or damaged recording is more than one sentence."""

import contextlib
import json
import os
import shutil
from collections import Counter

import pytest

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import RecordingError, SmartTouchError
from smarttouch.running.check_recording import check_recording
from smarttouch.running.inputs import ControlState
from smarttouch.running.recorded_source import RecordedControls, RecordingSource
from smarttouch.running.recording_files import describe, export, is_sound, repair
from smarttouch.running.recording_reader import Recording
from smarttouch.stimulation.sequence_limits import LONGEST_PERIOD_US

from ..raising import raises
from ..whole import WHOLE
from .forged_recordings import damage, forge, put_together, take_apart

MUTANTS = int(os.environ.get("SMARTTOUCH_MUTANTS", "25" if WHOLE else "12"))


def play(path):
    source = RecordingSource(Recording(path), unpaced=True)
    with contextlib.closing(source):
        while source.read(0) is not None:
            pass


def follow(path):
    RecordedControls(Recording(path), ControlState(Mode.RA, 1.0), tuple(Mode)).state(10**9)


def uses(path):
    """Return all that is done with a recording, by name."""
    mended, folder = path.with_name("mended.mcap"), path.with_name("folder")
    mended.unlink(missing_ok=True)
    shutil.rmtree(folder, ignore_errors=True)
    return {
        "info": lambda: describe(path), "check": lambda: check_recording(path),
        "sound": lambda: is_sound(path), "repair": lambda: repair(path, mended),
        "export": lambda: export(path, folder), "play": lambda: play(path),
        "follow": lambda: follow(path),
    }  # fmt: skip


def outcomes(path, what):
    """Return how each use of a recording went, by the kind of error."""
    found = {}
    for name, use in uses(path).items():
        try:
            use()
            found[name] = ""
        except SmartTouchError as error:
            found[name] = type(error).__name__
            told = str(error)
        except Exception as error:
            raise AssertionError(f"{name} after {what}: {error!r}") from error
        if found[name]:
            assert 10 < len(told) < 4000, (name, what)
    return found


@pytest.mark.timeout(0)
def test_forged(tmp_path, goldens):
    parts = [take_apart(each) for each in goldens]
    went = Counter()
    for seed in range(MUTANTS):
        path = tmp_path / "forged.mcap"
        what = forge(path, parts[seed % len(parts)], seed)
        went.update(outcomes(path, f"{what} of {goldens[seed % len(parts)].name}, {seed}").items())
    print(went)
    assert went["repair", ""] > MUTANTS / 4
    assert went["check", "RecordingError"] > 0


@pytest.mark.timeout(0)
def test_damaged(tmp_path, recording):
    whole, went = recording.read_bytes(), Counter()
    for seed in range(MUTANTS):
        path = tmp_path / "damaged.mcap"
        path.write_bytes(damage(whole, seed))
        went.update(outcomes(path, f"damage {seed}").items())
    print(went)
    assert went["play", ""] > MUTANTS / 4


def test_what_is_forged_from_is_sound(tmp_path, goldens):
    for golden in goldens:
        path = tmp_path / "same.mcap"
        put_together(path, *take_apart(golden))
        assert set(outcomes(path, "nothing").values()) == {""}
        path.unlink()


@pytest.fixture
def put(tmp_path, golden):
    """Return a writer of a changed golden, from what changes its settings or its messages."""

    def write(settings=None, messages=lambda each: each):
        about, taken = take_apart(golden("ra"))
        table = json.dumps(json.loads(about["settings"]) | (settings or {}))
        path = tmp_path / "forged.mcap"
        put_together(path, {**about, "settings": table}, messages(taken))
        return path

    return write


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mode", "XX"), ("mode", None), ("rate_hz", 0), ("rate_hz", float("nan")), ("rate_hz", "a"),
        ("softness", 2), ("softness", float("nan")), ("hold", "x"), ("balance", "perhaps"),
        ("timing", None), ("timing", {"load": 0}), ("timing", {"scan_us": float("inf")}),
        ("timing", {"unknown": 1}), ("timing", {"width_us": -1}), ("tone", {"faintest": 3}),
        ("tone", []), ("sharing", {"primaries": ["XX"]}), ("sharing", {"primaries": 3}),
        ("light_on_dark", [1]), ("compliance_v", -1), ("compliance_v", None),
    ],
)  # fmt: skip
def test_impossible_settings(put, key, value):
    # Where charge is held, a voltage is needed.
    unknown = (key, value) == ("compliance_v", None)
    path = put({key: value} | ({"hold": "charge"} if unknown else {}))
    with raises(RecordingError, about=lambda about: about.startswith(f"settings.{key}")) as caught:
        check_recording(path)
    assert not unknown or str(path) in str(caught.value)
    assert len(describe(path)) > 10


@pytest.mark.parametrize(
    ("topic", "key", "value"),
    [
        ("/sequence", "period_us", 0), ("/sequence", "period_us", LONGEST_PERIOD_US + 1),
        ("/sequence", "period_us", 2**63),
        pytest.param("/sequence", "period_us", 10**400, id="endless"),
        ("/sequence", "asked_us", 2**63), ("/sequence", "recharge_us", 2**40),
        ("/sequence", "level", 1.5), ("/sequence", "level", -0.1),
        ("/sequence", "intensity", float("nan")), ("/sequence", "intensity", 2.0),
        ("/finger", "time_ns", 2**62), ("/finger", "time_ns", -1), ("/finger", "age_ms", -1),
    ],
)  # fmt: skip
def test_numbers_that_no_run_has(put, topic, key, value):
    """Of the last step: what comes before it is played, and then nothing waits for ever."""

    def change(messages):
        at = max(at for at, each in enumerate(messages) if each[0] == topic)
        name, content, time_ns, index = messages[at]
        messages[at] = (name, content | {key: value}, time_ns, index)
        return messages

    with raises(RecordingError, about=key.replace("age_ms", "age_ns")):
        play(put(messages=change))


def test_where_steps_are_missing_there_is_no_current(put):
    # A step every 50 ms.
    path = put(messages=lambda all_: [each for each in all_ if each[3] < 5 or each[3] > 12])
    with contextlib.closing(RecordingSource(Recording(path))) as source:
        stale = [source.read(time_ms * 10**6).stale for time_ms in (240, 345, 355, 640, 655)]
    assert stale == [False, False, True, True, False]
