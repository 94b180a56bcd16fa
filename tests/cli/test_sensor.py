"""``smarttouch devices``: what it shows of sensors, and the ones it emulates."""

import re
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from smarttouch.base.errors import ProfileError, SourceError
from smarttouch.cli.devices import devices

from .conftest import says


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Return a runner of the command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return lambda *arguments: CliRunner().invoke(devices, [str(each) for each in arguments])


def table(output):
    return {line[:13].strip(): line[13:].strip() for line in output.splitlines()}


def test_a_page_is_shown(run):
    shown = run("show", "text:touch", "--seconds", 0.2)
    assert shown.exit_code == 0, shown.exception
    rows = table(shown.output)
    assert rows["source"]
    assert re.findall(r"\d+", rows["read"]) == ["21", "100"]
    assert rows["size"].startswith("64 x 64, ")
    assert re.search(r"\b0\.\d+ N", rows["force"])


def test_a_force_is_shown(run):
    shown = run("show", "fixed:0.25", "--seconds", 0.2)
    assert shown.exit_code == 0, shown.exception
    assert re.findall(r"\b\d\.\d{3}\b", shown.output)[:3] == ["0.250"] * 3
    assert "0 of 21 " in shown.output


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("show nothing:", says(SourceError, value="nothing:")),
    ("show text:x --seconds 0", says(value=0, allowed=(0, 3600))),
    ("show text:x --profile none", says(ProfileError, "'none'")),
    ("show hx711:/dev/nowhere",
     says(SourceError, "electric-mouse", "force.curve", "0.00980665")),
    ("emulate mouse",
     says(value="mouse", allowed=("serial-array", "hx711", "loadcell"))),
    ("emulate hx711?books=no/where", says(value=Path("no/where"))),
])  # fmt: skip
def test_wrong_requests_end_in_one_sentence(run, arguments, wrong):
    wrong(run(*arguments.split()).exception)


def test_an_array_is_played_and_shown(run):
    program = "from smarttouch.cli.devices import devices; devices()"
    arguments = ["emulate", "serial-array"]
    with subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert select.select([process.stdout], [], [], 30)[0], "it prints nothing"
            said = [process.stdout.readline() for _ in range(3)][-1].split()
            assert said[:2] == ["smarttouch", "live"]
            url = said[2]
            shown = run("show", url, "--seconds", 0.3)
            assert shown.exit_code == 0, shown.exception
            rows = table(shown.output)
            assert re.findall(r"\d+", rows["size"])[:4] == ["64", "64", "40", "220"]
            assert not re.search(r"\d", rows["force"])
            assert int(rows["frames"].partition(",")[0]) > 0
        finally:
            process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
