"""Tests of ``smarttouch replay``: summary, check, and replay to a board."""

import json
import os
import re
import tty
from pathlib import Path

import pytest

from smarttouch.base.errors import BoardError, RecordingError, SourceError

from ..boards.emulator_waits import fresh_state
from ..running.forged_recordings import put_together, take_apart
from ..support.full import sample
from .conftest import refused, says


@pytest.fixture
def recording(tmp_path):
    """Return a copy of a reference recording, which a test can damage."""
    golden = Path(__file__).parents[1] / "running" / "goldens" / "sai-levels.mcap"
    path = tmp_path / "run.mcap"
    path.write_bytes(golden.read_bytes())
    return path


def test_info_has_what_an_ethics_board_asks(program_here, recording):
    done = program_here("replay", recording, "--info")
    assert done.returncode == 0
    for told in (
        "2023-11-14 22:13:20 UTC", "1.5 s", "nobody", "electric-mouse", "SAI 38", "mA",
        "smarttouch 1.0.0rc1", "0.06 MB", "0.600 s  intensity 0.40", "paused",
    ):  # fmt: skip
        assert told in done.stdout


def test_damage_is_reported(program_here, recording):
    content = recording.read_bytes()
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 1
    states = (content, "complete"), (content[:-200], "incomplete:"), (flipped, "damaged:")
    for broken, state in states:
        recording.write_bytes(broken)
        done = program_here("replay", recording, "--info")
        assert done.returncode == 0
        assert done.stdout.split()[:2] == ["state", state]
        assert "electric-mouse" in done.stdout


def test_a_check_that_holds_and_one_that_does_not(program_here, recording, tmp_path):
    done = program_here("replay", recording, "--check")
    assert done.returncode == 0
    assert re.fullmatch(r"38 .*\d+ .*\n", done.stdout)
    from smarttouch.base.files import data_folder

    text = (data_folder("calibration") / "electric-mouse.toml").read_text()
    assert "ramp_s = 0.5" in text
    other = tmp_path / "other.toml"
    other.write_text(text.replace("ramp_s = 0.5", "ramp_s = 0.6"))
    done = program_here("replay", recording, "--check", "--profile", other)
    assert done.returncode == 1
    head, *differences = done.stdout.splitlines()
    assert head.startswith("38 ")
    assert len(differences) > 1
    assert differences[0].startswith("frame 0 at ")


GOLDEN = Path(__file__).parents[1] / "running" / "goldens" / "kajimoto.mcap"


@pytest.fixture
def forge(tmp_path):
    """Return a function that writes a recording whose profile differs in one key."""

    def make(key, value):
        about, messages = take_apart(GOLDEN)
        profile = json.loads(about["profile"])
        table, name = key.split(".")
        profile[table][name] = value
        path = tmp_path / "forged.mcap"
        put_together(path, about | {"profile": json.dumps(profile)}, messages)
        return path

    return make


@pytest.fixture
def port():
    """Yield the far end and the name of a serial port without a board."""
    far, near = os.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    yield far, os.ttyname(near)
    os.close(near)
    os.close(far)


@pytest.fixture
def into(program_here):
    """Return a function that replays a recording to a board and returns the error."""
    board = "--intensity", 1, "--board"
    return lambda recording, url: refused(program_here("replay", recording, *board, url))


@pytest.mark.parametrize("scale", [0.00244, 2440.0])
def test_a_misread_unit_in_a_recording_reaches_no_board(forge, port, into, monkeypatch, scale):
    """On a finger, the scale of outputs comes from the user's profile, not from the recording."""
    outputs = []

    def made(_url, _limits, output):
        outputs.append(output)
        raise BoardError("seen")

    monkeypatch.setattr("smarttouch.running.display.make_board", made)
    path = forge("output.ua_per_count", scale)
    assert isinstance(into(path, f"kajimoto61:{port[1]}"), BoardError)
    assert [each.ua_per_count for each in outputs] == [None]


NONSENSE = [
    ("output.ua_per_count", float("nan")), ("limits.current_ma", 50.0),
    ("limits.charge_uc", 5.0), ("limits.duty", float("nan")), ("limits.ramp_s", 0.0),
    ("limits.unknown", 1.0),
]  # fmt: skip


@pytest.mark.parametrize(("key", "value"), NONSENSE)
def test_what_a_profile_may_not_hold_a_recording_may_not(forge, port, into, key, value):
    far, name = port
    assert isinstance(into(forge(key, value), f"kajimoto61:{name}"), RecordingError)
    with pytest.raises(BlockingIOError):
        os.read(far, 1)


def forge_a_strong_one(path, comfort_ma):
    """Write a recording with high limits in its profile, and with force on the finger."""
    about, messages = take_apart(GOLDEN.with_name("ra.mcap"))
    profile = json.loads(about["profile"])
    profile["limits"] |= {"current_ma": 5.0, "charge_uc": 0.5, "ramp_s": 0.5}
    profile["pulse"]["width_us"] = 100
    profile["force"] |= {"contact_n": 1e-6, "full_n": 2e-6, "source": "fixed:1"}
    profile["perception"] |= {"comfort_ma": [comfort_ma] * 64, "threshold_ma": 0.6}
    for topic, content, _, _ in messages:
        if topic == "/step":
            content |= {"force_n": 20.0, "level": 1.0}
    put_together(path, about | {"profile": json.dumps(profile)}, messages)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("comfort_ma", "events", "most_ma"),
    # Cases: a comfort level above the user's limit of 2.4 mA; one below; a board that measures 0 N.
    sample([(4.998, (), 2.4), (1.2, (), 1.2), (4.998, ("event=0 force 0",), 0.0)]),
)
def test_a_recording_brings_to_a_finger_neither_limits_nor_force(
    program_here, start_emulator, tmp_path, comfort_ma, events, most_ma
):
    forge_a_strong_one(tmp_path / "a.mcap", comfort_ma)
    _, port, books = start_emulator(64, "link", *events)
    board = ("--board", f"link:{port}", "--intensity", 1)
    for command in (("replay", "a.mcap"), ("live", "recording:a.mcap")):
        program_here(*command, *board).fine()
    state = fresh_state(books)
    assert (state["unsafe"], state["violations"]) == (0, 0)
    assert 0.5 * most_ma <= state["max_current_ma"] <= most_ma * 1.02


@pytest.mark.realtime
def test_a_recording_brings_no_press_where_no_force_is_measured(
    program_here, start_emulator, tmp_path
):
    forge_a_strong_one(tmp_path / "a.mcap", 4.998)
    # On a board without force sensor a run needs --force; the recorded force does not count.
    _, port, books = start_emulator(61, "kajimoto61")
    for command in (("replay", "a.mcap"), ("live", "text:on")):
        done = program_here(*command, "--board", f"kajimoto61:{port}", "--intensity", 1)
        says(SourceError)(refused(done))
    assert fresh_state(books)["max_current_ma"] == 0
