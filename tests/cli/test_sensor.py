"""``smarttouch sensor``: what it shows of sensors, and the ones it plays."""

import json
import select
import signal
import subprocess
import sys

import pytest
from PIL import Image
from typer.testing import CliRunner

from smarttouch.cli.sensor import sensor
from smarttouch.errors import SmartTouchError


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Return a runner of the command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return lambda *arguments: CliRunner().invoke(sensor, [str(each) for each in arguments])


def table(output):
    return {line[:13].strip(): line[13:].strip() for line in output.splitlines()}


def test_a_page_is_shown_and_its_last_frame_kept(run, tmp_path):
    shown = run("show", "text:touch", "--seconds", 0.2, "--save", "last.png")
    assert shown.exit_code == 0, shown.exception
    rows = table(shown.output)
    assert rows["sensor"] == "printed text"
    assert rows["read"] == "21, asked 100 times a second"
    assert rows["size"].startswith("64 x 64, grey ")
    assert "to 0." in rows["force"]
    with Image.open(tmp_path / "last.png") as image:
        assert (image.size, image.mode) == ((64, 64), "L")


def test_a_force_is_shown(run, tmp_path):
    (tmp_path / "force.csv").write_text("time_s,force_n\n0,0.25\n0.1,0.25\n")
    shown = run("show", "recorded:force.csv", "--force", "--seconds", 0.2)
    assert shown.exit_code == 0, shown.exception
    assert "0.250 to 0.250 N, mean 0.250" in shown.output
    assert "10 of 21 times asked" in shown.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["show", "nothing:"], "unknown source 'nothing:'"),
        (["show", "text:x", "--force"], "unknown force 'text:x'"),
        (["show", "text:x", "--seconds", "0"], "--seconds 0 must be above 0"),
        (["show", "text:x", "--seconds", "nan"], "--seconds nan must be above 0"),
        (["show", "text:x", "--save", "no/where.png"], "cannot write no/where.png"),
        (["show", "text:x", "--baud", "9600"], "text: does not take baud"),
        (["show", "text:x", "--size", "9"], "--size '9' is not a size"),
        (["show", "fixed:1", "--force", "--baud", "9600"], "are for frames: leave out --force"),
        (["show", "text:x", "--profile", "none"], "no profile 'none'"),
        (["show", "serial-array:/dev/nowhere"], "there is no such port"),
        (["show", "hx711:/dev/nowhere", "--force"], "has no force.curve"),
        (["emulate", "mouse"], "no emulator 'mouse': choose serial-array, hx711, loadcell"),
        (["emulate", "hx711", "--books", "no/where"], "cannot write no/where"),
        (["emulate", "hx711", "--rate", "-1"], "did not start: --rate -1 is out of range"),
    ],
)
def test_wrong_requests_end_in_one_sentence(run, arguments, words):
    ended = run(*arguments)
    assert isinstance(ended.exception, SmartTouchError)
    assert words in str(ended.exception)
    assert "\n" not in str(ended.exception)


def test_an_array_is_played_and_shown(run, tmp_path):
    books = tmp_path / "books.json"
    program = "from smarttouch.cli.sensor import sensor; sensor()"
    arguments = ["emulate", "serial-array", "--rows=8", "--columns=12", f"--books={books}"]
    with subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert select.select([process.stdout], [], [], 30)[0], "it prints nothing"
            said = [process.stdout.readline() for _ in range(4)]
            assert said[0] == "A sensor array. In another terminal:\n"
            url = said[2].split()[-1]
            assert said[3].startswith(f"  smarttouch live --sensor {url} ")
            shown = run("show", url, "--seconds", 0.3)
            assert shown.exit_code == 0, shown.exception
            rows = table(shown.output)
            assert rows["size"].startswith("12 x 8, grey 40 to 220")
            assert rows["force"] == "not known"
            frames = int(rows["frames"].partition(",")[0])
        finally:
            process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
    assert json.loads(books.read_text())["sent"] >= frames > 0
