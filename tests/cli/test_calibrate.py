"""Tests of all calibrations: their output, the profiles that they write, and their errors."""

import os
import sys
import threading
import time

import pytest
from PIL import Image
from typer.testing import CliRunner

from smarttouch.base.errors import BoardError, CalibrationError, ProfileError, SourceError
from smarttouch.cli.calibrate import calibrate
from smarttouch.emulator.device_lines import PtyLine
from smarttouch.emulator.devices import EmulatedLoadCell, Server
from smarttouch.emulator.firmware_base import read_state
from smarttouch.experiments.sensor_calibration import target_for
from smarttouch.profile import load_profile
from smarttouch.sources.flat_field_and_motion import FlatField

from ..boards.emulator_waits import fresh_state, until
from ..experiments.simulated_sensors import SimulatedPatch, View
from .conftest import PRESSED, says


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Return a function that runs ``calibrate`` in an empty folder; ``typed`` is the input.

    A first argument with several words is split at spaces.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))

    def invoke(*arguments, typed=""):
        words = [*arguments[0].split(), *map(str, arguments[1:])]
        return CliRunner().invoke(calibrate, words, input=typed)

    return invoke


def done(result):
    assert result.exit_code == 0, result.exception
    assert "mine.toml" in result.output.splitlines()[-1]
    return result.output


def wrong(*names, **attributes):
    return says(CalibrationError, *names, **attributes)


def save(folder, images):
    folder.mkdir()
    for number, image in enumerate(images):
        Image.fromarray(image).save(folder / f"{number:03}.png")


def test_one_profile_for_all(run, tmp_path, profile, monkeypatch):
    patch = SimulatedPatch(dead=2)
    save(tmp_path / "dark", patch.images(6, light=False))
    save(tmp_path / "white", patch.images(6, light=True))

    def put_there(question, **_options):
        (tmp_path / "now").unlink(missing_ok=True)
        kind = "dark" if "Cover" in question else "white" if "white" in question else "seen"
        (tmp_path / "now").symlink_to(tmp_path / kind)
        return ""

    monkeypatch.setattr("typer.prompt", put_there)
    view = View(zoom=0.85).render(target_for(profile), profile.optics, (64, 64))
    save(tmp_path / "seen", [view])
    optics = "optics --source frames:now --output mine.toml"
    shown = done(run(optics))
    assert "2 dead or hot" in shown
    mine = load_profile(tmp_path / "mine.toml")
    assert mine.calibrated["optics"].found in " ".join(shown.split())
    field_before = FlatField.load(mine.optics.flat_field).gain
    assert field_before.shape == (64, 64)
    done(run("registration --source frames:now --output mine.toml"))
    mine = load_profile(tmp_path / "mine.toml")
    assert set(mine.calibrated) == {"optics", "registration"}
    assert mine.optics.homography is not None
    assert {each.name for each in tmp_path.glob("mine*")} == {"mine.flat-field.npz", "mine.toml"}
    # Measuring again requires --overwrite, and must not apply the old flat field.
    before = (tmp_path / "mine.toml").read_bytes()
    wrong()(run(optics).exception)
    assert (tmp_path / "mine.toml").read_bytes() == before
    done(run(f"{optics} --overwrite"))
    assert FlatField.load(tmp_path / "mine.flat-field.npz").gain == pytest.approx(field_before)


def test_a_target_alone(run, tmp_path):
    result = run("registration --target target.png")
    assert result.exit_code == 0, result.exception
    assert " mm across" in result.output
    assert (tmp_path / "target.png").exists()


@pytest.fixture
def load_cell(monkeypatch):
    """Yield the URL of an emulated load cell, which carries the weight entered at each prompt."""
    cell, line = EmulatedLoadCell(0.0, framed=True, rate_hz=400), PtyLine()
    server, over = Server(cell, line), threading.Event()

    def serve():
        while not over.is_set():
            server.step(line.read(0.002), time.monotonic_ns())

    grams = ["0", "20", "50", "100", "50", "0", ""]

    def lay_on(_question, **_options):
        cell.force_n = float(grams[0] or 0) * 9.80665e-3
        # Wait until the samples of the previous weight have been transmitted.
        time.sleep(0.1)
        return grams.pop(0)

    monkeypatch.setattr("typer.prompt", lay_on)
    serving = threading.Thread(target=serve)
    serving.start()
    yield f"loadcell:{line.name}"
    over.set()
    serving.join()
    line.close()


def test_force_of_an_emulated_load_cell(run, tmp_path, load_cell):
    for seconds in (0.15, 3.0):
        # On a busy computer the first reading can be too short: read longer.
        result = run(f"force --cell {load_cell} --seconds {seconds} --output mine.toml")
        if not isinstance(result.exception, CalibrationError):
            break
    shown = done(result)
    assert "line through 6 weighings from 0 to 100 g" in shown
    zero_n, slope_n = load_profile(tmp_path / "mine.toml").force.curve
    # The emulated cell counts 80,000 at zero force, and 50,000 more per newton.
    assert slope_n == pytest.approx(1 / 50_000, rel=0.01)
    assert zero_n == pytest.approx(-1.6, rel=0.01)


def test_thresholds_stop_at_once(start_at_a_terminal, start_emulator, tmp_path):
    _, port, books = start_emulator()
    arguments = ("calibrate", "thresholds", "--board", f"link:{port}", *PRESSED)
    process, keys = start_at_a_terminal(*arguments, "--output", "mine.toml", "--electrodes", "5")
    until(lambda: read_state(books)["slots"])
    os.write(keys, b"q")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "electrode 5" in out
    assert "1 of 1 electrodes" in err
    assert err.count("\n") == 1
    state = fresh_state(books)
    assert (state["state"], state["unsafe"], state["violations"]) == ("shorted", 0, 0)
    assert not (tmp_path / "mine.toml").exists()


@pytest.mark.realtime
def test_contact_masks_what_does_not_touch(run, start_emulator, tmp_path, monkeypatch):
    monkeypatch.setattr("smarttouch.boards.kits.BOOT_S", 0.0)
    # Measure less often: on a busy computer a long measurement can exceed the host timeout.
    monkeypatch.setattr(sys.modules["smarttouch.cli.calibrate"], "_REPEATS", 2)
    events = ("event=0 open 5", "event=0 short 9")
    _, port, _ = start_emulator(32, "etactilekit", *events)

    def measured():
        result = run(f"contact --board etactilekit:{port} --output mine.toml")
        # On a busy computer the measurement can fail: measure again.
        return None if isinstance(result.exception, BoardError) else result

    shown = done(until(measured))
    profile = load_profile(tmp_path / "mine.toml")
    assert profile.title == load_profile("etactilekit-32").title
    assert profile.output.masked == (5, 9)
    assert all(10 < each < 60 for each in profile.output.impedance_kohm)
    assert len(set(profile.output.impedance_kohm)) > 10
    said = "30 good, 1 open (electrodes 5), 1 short (electrodes 9) of 32 electrodes"
    assert said in profile.calibrated["contact"].found
    assert said in shown
    assert "[5, 9]" in shown


@pytest.mark.parametrize(("arguments", "check"), [
    ("optics", wrong()),
    ("optics --source nothing:", says(SourceError, value="nothing:")),
    ("optics --source frames:none", says(SourceError, " none:")),
    ("registration", wrong()),
    ("force", wrong("hx711:PORT")),
    ("force --cell loadcell:none", says(SourceError, "none")),
    ("thresholds", wrong()),
    ("thresholds --electrodes 64", wrong(value="64", allowed=63)),
    ("contact --board memory:", says(BoardError, "measure")),
    ("contact --profile nobody", says(ProfileError, "'nobody'")),
])  # fmt: skip
def test_what_cannot_be_is_one_sentence(run, tmp_path, arguments, check):
    check(run(arguments, "--output", "mine.toml", typed="\n").exception)
    assert not list(tmp_path.glob("*mine*"))


def test_what_is_measured_needs_a_place(run):
    wrong()(run("registration --source frames:none").exception)
    nowhere = run("force --cell loadcell:none --output none/mine.toml")
    wrong("none/mine.toml")(nowhere.exception)
