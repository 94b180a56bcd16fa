"""The profile inside a recording is believed no more than a profile file."""

import json
import os
import tty
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from smarttouch.cli.replay import replay
from smarttouch.errors import BoardError, ProfileError, RecordingError
from smarttouch.profile import load_profile
from smarttouch.recording.reader import Recording
from smarttouch.recording.repair import repair

GOLDEN = Path(__file__).parents[1] / "recording" / "goldens" / "kajimoto.mcap"


@pytest.fixture
def forge(tmp_path, monkeypatch):
    """Return a maker of recordings whose profile differs in one key."""

    def make(key, value):
        class Forged(Recording):
            def __init__(self, path):
                super().__init__(path)
                table = json.loads(self.about["profile"])
                *tables, last = key.split(".")
                inner = table
                for name in tables:
                    inner = inner[name]
                inner[last] = value
                self.about["profile"] = json.dumps(table)

        with monkeypatch.context() as patch:
            patch.setattr("smarttouch.recording.repair.Recording", Forged)
            return repair(GOLDEN, tmp_path / "forged.mcap").path

    return make


@pytest.fixture
def port():
    """A serial port that nobody answers at: its far end and its name."""
    far, near = os.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    yield far, os.ttyname(near)
    os.close(near)
    os.close(far)


@pytest.fixture
def into():
    """Return what replays a recording into a board; its error."""
    app = typer.Typer()
    app.command()(replay)

    def run(recording, url):
        done = CliRunner().invoke(app, [str(recording), "--board", url, "--intensity", "1"])
        assert "\n" not in str(done.exception)
        return done.exception

    return run


@pytest.mark.parametrize("scale", [0.00244, 2440.0, 1.0, 9.99])
def test_a_misread_unit_in_a_recording_reaches_no_board(forge, port, into, scale):
    far, name = port
    error = into(forge("output.ua_per_count", scale), f"kajimoto61:{name}")
    assert isinstance(error, BoardError)
    assert "ua_per_count" in str(error)
    with pytest.raises(BlockingIOError):
        os.read(far, 1)


NONSENSE = [
    ("output.ua_per_count", float("nan")),
    ("output.ua_per_count", float("inf")),
    ("output.ua_per_count", -2.44),
    ("limits.current_ma", 50.0),
    ("limits.pulse_us", 2000.0),
    ("limits.charge_uc", 5.0),
    ("limits.duty", float("nan")),
    ("limits.rate_hz", float("nan")),
    ("limits.ramp_s", 0.0),
    ("limits.total_ma", float("inf")),
    ("limits.unknown", 1.0),
    ("perception.threshold_ma", float("nan")),
]


@pytest.mark.parametrize(("key", "value"), NONSENSE)
def test_what_a_profile_may_not_say_a_recording_may_not(forge, port, into, key, value):
    far, name = port
    assert isinstance(into(forge(key, value), f"kajimoto61:{name}"), RecordingError)
    with pytest.raises(BlockingIOError):
        os.read(far, 1)


@pytest.mark.parametrize(("key", "value"), NONSENSE)
def test_nor_may_a_file(tmp_path, key, value):
    import tomlkit

    from smarttouch.resources import data_folder

    text = (data_folder("calibration") / "kajimoto-61.toml").read_text(encoding="utf-8")
    table = tomlkit.parse(text)
    first, last = key.split(".")
    table[first][last] = value
    path = tmp_path / "own.toml"
    path.write_text(tomlkit.dumps(table), encoding="utf-8")
    with pytest.raises(ProfileError) as error:
        load_profile(path)
    assert "\n" not in str(error.value)
