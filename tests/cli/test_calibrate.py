"""All five calibrations, walked through: what they show, write, and refuse to write."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from smarttouch.boards.emulator.books import read_state
from smarttouch.calibrate.progress import Progress
from smarttouch.calibrate.simulated import SimulatedPatch
from smarttouch.calibrate.target import target_for
from smarttouch.calibrate.view import View
from smarttouch.cli.calibrate import calibrate
from smarttouch.errors import CalibrationError, SensorError, SmartTouchError
from smarttouch.profile import load_profile
from smarttouch.sources.flat_field import FlatField


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Return a runner of the command in an empty folder; what is typed comes as text."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))

    def invoke(*arguments, typed=""):
        return CliRunner().invoke(calibrate, [str(each) for each in arguments], input=typed)

    return invoke


def done(result):
    assert result.exit_code == 0, result.exception
    assert "written: " in result.output
    return result.output


def refused(result, said, kind=SmartTouchError):
    assert isinstance(result.exception, kind), result.exception
    assert said in str(result.exception)
    assert "\n" not in str(result.exception)


def save(folder, images):
    folder.mkdir()
    for number, image in enumerate(images):
        Image.fromarray(image).save(folder / f"{number:03}.png")


@pytest.mark.parametrize("what", ["optics", "registration", "force"])
def test_walked_through_without_hardware(run, tmp_path, what):
    shown = done(run(what, "--simulate", "--output", "mine.toml"))
    profile = load_profile(tmp_path / "mine.toml")
    assert profile.calibrated[what].found.startswith("simulated: ")
    assert profile.calibrated[what].found in " ".join(shown.split())
    # Never measured again without being told to.
    before = (tmp_path / "mine.toml").read_bytes()
    again = run(what, "--simulate", "--output", "mine.toml").exception
    assert isinstance(again, CalibrationError)
    assert (again.about, again.problem, again.remedy) == (what, "exists", "--overwrite")
    assert (tmp_path / "mine.toml").read_bytes() == before
    done(run(what, "--simulate", "--output", "mine.toml", "--overwrite"))


def test_one_profile_for_all(run, tmp_path):
    done(run("optics", "--simulate", "--output", "mine.toml"))
    for what in ("registration", "force"):
        done(run(what, "--output", "mine.toml", "--simulate"))
    profile = load_profile(tmp_path / "mine.toml")
    assert set(profile.calibrated) == {"optics", "registration", "force"}
    assert FlatField.load(profile.optics.flat_field).gain.shape == (64, 64)
    assert profile.optics.homography is not None
    assert profile.force.curve is not None


def test_optics_from_folders(run, tmp_path):
    patch = SimulatedPatch((32, 40), dead=2)
    save(tmp_path / "dark", patch.images(6, light=False))
    save(tmp_path / "white", patch.images(6, light=True))
    folders = ("--dark", "frames:dark", "--white", "frames:white")
    shown = done(run("optics", *folders, "--output", "mine.toml"))
    assert "2 dead" in shown
    field = FlatField.load(load_profile(tmp_path / "mine.toml").optics.flat_field)
    assert field.gain.shape == (32, 40)
    assert sorted(each.name for each in tmp_path.glob("mine*")) == [
        "mine.flat-field.npz",
        "mine.toml",
    ]
    # A sensor that is calibrated again is seen as it is, without its old flat field.
    again = ("--profile", "mine.toml", "--output", "mine.toml", "--overwrite")
    field_before = field.gain.copy()
    done(run("optics", *folders, *again))
    assert FlatField.load(tmp_path / "mine.flat-field.npz").gain == pytest.approx(field_before)


def test_optics_asks_for_dark_and_white(run, tmp_path):
    save(tmp_path / "same", SimulatedPatch().images(4, light=True))
    asked = run("optics", "--sensor", "frames:same", "--output", "mine.toml", typed="\n\n")
    assert "Cover the sensor" in asked.output
    assert "blank white paper" in asked.output
    refused(asked, "only 0 grey levels brighter than dark", CalibrationError)
    unanswered = run("optics", "--sensor", "frames:same", "--output", "mine.toml")
    refused(unanswered, "nobody answered, nothing was written: --yes")
    assert not list(tmp_path.glob("mine*"))


def test_registration_of_a_camera(run, tmp_path, profile):
    view = View(tilt_deg=18, toward_deg=50, turn_deg=-12, zoom=0.85)
    save(tmp_path / "seen", [view.render(target_for(profile), profile.optics, (480, 640))])
    shown = done(
        run("registration", "--sensor", "frames:seen", "--output", "mine.toml", "--yes",
            "--target", "target.png")
    )  # fmt: skip
    assert "pitch on the page" in shown
    optics = load_profile(tmp_path / "mine.toml").optics
    assert (optics.sensor_columns, optics.sensor_rows) == (640, 480)
    truth = view.homography(profile.optics, (480, 640))
    found = np.reshape(optics.homography, (3, 3))
    assert found == pytest.approx(truth / truth[2, 2], rel=0.02, abs=0.01)
    with Image.open(tmp_path / "target.png") as image:
        assert image.info["dpi"][0] == pytest.approx(1270, abs=1)
    again = run("registration", "--target", "target.png")
    refused(again, "target.png exists already", CalibrationError)


def test_a_target_alone(run, tmp_path):
    result = run("registration", "--target", "target.png", "--dot-pitch-mm", 0.5)
    assert result.exit_code == 0, result.exception
    assert "dots 0.5 mm apart" in result.output
    assert (tmp_path / "target.png").exists()


@pytest.fixture
def load_cell(monkeypatch):
    """An emulated cell on a serial line; who is asked for a weight lays it on."""
    with subprocess.Popen(
        [sys.executable, "-m", "smarttouch.sources.emulator", "loadcell", "--rate=400"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        port = process.stdout.readline().strip()

        def lay_on(text, **_options):
            process.stdin.write(f"weight {text.split()[0]}\n")
            process.stdin.flush()
            time.sleep(0.1)

        monkeypatch.setattr("typer.prompt", lay_on)
        yield f"loadcell:{port}"
        process.kill()
        process.communicate()


def test_force_of_an_emulated_load_cell(run, tmp_path, load_cell):
    weights = "0,20,50,100,50,0"
    options = ("--cell", load_cell, "--weights", weights, "--seconds", 0.15)
    shown = done(run("force", *options, "--output", "mine.toml"))
    assert "line through 6 weighings from 0 to 100 g" in " ".join(shown.split())
    zero_n, slope_n = load_profile(tmp_path / "mine.toml").force.curve
    # The emulator's own: 50,000 counts a newton above 80,000.
    assert slope_n == pytest.approx(1 / 50_000, rel=0.01)
    assert zero_n == pytest.approx(-1.6, rel=0.01)


def test_a_load_cell_that_nothing_moves(run, tmp_path, load_cell):
    stuck = ("--cell", load_cell, "--weights", "0,50,100", "--seconds", 0.15, "--yes")
    refused(run("force", *stuck, "--output", "mine.toml"), "the readings move by", CalibrationError)
    assert not (tmp_path / "mine.toml").exists()


def test_thresholds_of_a_simulated_subject(run, tmp_path):
    shown = done(run("thresholds", "--simulate", "--electrodes", "0-2,9", "--output", "mine.toml"))
    profile = load_profile(tmp_path / "mine.toml")
    assert shown.count(", comfortable to ") == 4
    assert profile.calibrated["thresholds"].found.startswith("simulated: 4 electrodes")
    threshold, comfort = profile.perception.threshold_ma, profile.perception.comfort_ma
    measured = [0, 1, 2, 9]
    assert all(threshold[each] != 1.2 for each in measured)
    assert {threshold[each] for each in set(range(64)) - set(measured)} == {1.2}
    assert {comfort[each] for each in set(range(64)) - set(measured)} == {2.4}
    assert not (tmp_path / "mine.thresholds.json").exists()


def test_a_second_session_for_the_same_profile_is_refused(run, tmp_path):
    alone = ("--simulate", "--board", "memory:", "--electrodes", "0", "--output", "mine.toml")
    with Progress(tmp_path / "mine.thresholds.json", {}):
        refused(run("thresholds", *alone), "mine.thresholds.json", CalibrationError)
    assert not list(tmp_path.glob("*mine*"))


def test_thresholds_with_trials_on_another_board(run, tmp_path):
    done(
        run("thresholds", "--simulate", "--adaptive", "--electrodes", "60", "--board", "memory:",
            "--profile", "kajimoto-61", "--output", "mine.toml")
    )  # fmt: skip
    profile = load_profile(tmp_path / "mine.toml")
    assert "yes or no after rising current" in profile.calibrated["thresholds"].found


def test_thresholds_stop_at_once(start_at_a_terminal, start_emulator, tmp_path):
    _, port, books = start_emulator()
    arguments = ("calibrate", "thresholds", "--board", f"link:{port}", "--output", "mine.toml")
    process, keys = start_at_a_terminal(*arguments, "--electrodes", "5")
    deadline = time.monotonic() + 20
    while not read_state(books)["slots"]:
        assert time.monotonic() < deadline, "it never pulsed"
        time.sleep(0.05)
    os.write(keys, b"q")
    out, err = process.communicate(timeout=20)
    assert process.returncode == 2
    assert "Press a key when you feel it" in out
    assert "stopped, all electrodes are off: 1 of 1 electrodes are left" in err
    time.sleep(0.15)
    state = read_state(books)
    assert (state["state"], state["unsafe"], state["violations"]) == ("shorted", 0, 0)
    assert not (tmp_path / "mine.toml").exists()


def test_contact_masks_what_does_not_touch(run, start_emulator, tmp_path, monkeypatch):
    monkeypatch.setattr("smarttouch.boards.streamed.BOOT_S", 0.0)
    events = ("--event=0 open 5", "--event=0 short 9")
    _, port, _ = start_emulator(32, "etactilekit", *events)
    shown = done(
        run("contact", "--board", f"etactilekit:{port}", "--repeats", 2, "--output", "mine.toml")
    )
    profile = load_profile(tmp_path / "mine.toml")
    assert profile.title == load_profile("etactilekit-32").title
    assert profile.output.masked == (5, 9)
    assert all(10 < each < 60 for each in profile.output.impedance_kohm)
    assert len(set(profile.output.impedance_kohm)) > 20
    assert "30 good, 1 open, 1 short of 32 el" in profile.calibrated["contact"].found
    rows = [line.split() for line in shown.splitlines()[:4]]
    assert (rows[0][5], rows[1][1]) == ("open", "short")
    assert "Masked now: [5, 9]" in shown


def test_a_lifted_finger_writes_nothing(run, start_emulator, tmp_path):
    _, port, _ = start_emulator(64, "link", "--event=0 lift")
    lifted = run("contact", "--board", f"link:{port}", "--repeats", 1, "--output", "mine.toml")
    refused(lifted, "no electrode touches anything", CalibrationError)
    assert not (tmp_path / "mine.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "said", "kind"),
    [
        (["optics"], "give --sensor, or --dark and --white", CalibrationError),
        (["optics", "--dark", "frames:none"], "give --sensor, or", CalibrationError),
        (["optics", "--sensor", "nothing:", "--yes"], "unknown sensor", SensorError),
        (["optics", "--sensor", "frames:none", "--yes"], "none", SensorError),
        (["registration"], "give --sensor, or --simulate", CalibrationError),
        (["registration", "--center", "left"], "--center 'left'", CalibrationError),
        (["registration", "--dot-pitch-mm", "0"], "--dot-pitch-mm 0", CalibrationError),
        (["force"], "give --cell hx711:PORT", CalibrationError),
        (["force", "--simulate", "--seconds", "nan"], "--seconds nan", CalibrationError),
        (["force", "--simulate", "--weights", "0,a"], "'0,a' are not", CalibrationError),
        (["force", "--simulate", "--weights", "0,nan"], "'0,nan' are not", CalibrationError),
        (["force", "--simulate", "--weights", "0,1,2"], "far below full force", CalibrationError),
        (["thresholds"], "there is no keyboard", CalibrationError),
        (["thresholds", "--electrodes", "64"], "has electrodes 0 to 63", CalibrationError),
        (["thresholds", "--simulate", "--board", "link:/dev/null"], "only", CalibrationError),
        (["contact", "--board", "memory:"], "does not measure", SmartTouchError),
        (["contact", "--profile", "nobody"], "no profile 'nobody'", SmartTouchError),
    ],
)
def test_what_cannot_be_is_one_sentence(run, tmp_path, arguments, said, kind):
    refused(run(*arguments, "--output", "mine.toml"), said, kind)
    assert not list(tmp_path.glob("*mine*"))


def test_what_is_measured_needs_a_place(run):
    refused(run("registration", "--simulate"), "give --output", CalibrationError)
    refused(
        run("force", "--simulate", "--output", "none/mine.toml"), "its folder", CalibrationError
    )
