"""Tests of the example plug-ins, of the package in a how-to page, and of stimulus sources."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import smarttouch as st
from smarttouch import lab
from smarttouch.instruments.vibration_stimuli import ColorSource
from smarttouch.testing import StimulusContract

from ..support.plugin_packages import install_project

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "plugins"


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Return a function that runs Python with the example plug-ins installed."""
    place = tmp_path / "site"
    place.mkdir()
    for name in ("board", "source", "stimulus"):
        install_project(EXAMPLES / name, place)
    monkeypatch.setenv("PYTHONPATH", str(place), prepend=":")

    def run(*arguments, folder=tmp_path):
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=folder, capture_output=True, text=True, timeout=110, check=False,
        )  # fmt: skip

    return run


@pytest.mark.long
@pytest.mark.parametrize("name", ["board", "source", "stimulus"])
def test_their_own_tests_pass(program, name):
    options = ("-q", "-W", "error", "-p", "no:cacheprovider", "-c", "pyproject.toml")
    done = program("-m", "pytest", *options, folder=EXAMPLES / name)
    assert done.returncode == 0, done.stdout


def test_a_run_with_both(program, tmp_path):
    done = program(
        "-c", "from smarttouch.cli import main; main()", "live", "--board", "journal:run.txt",
        "bar:1.5?speed_mm_s=50", "--seconds", "0.5", "--force", "fixed:1", "--intensity", "1",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = (tmp_path / "run.txt").read_text("utf-8").splitlines()
    assert lines[0] == lines[-1] == "zero"
    assert sum(line.startswith("scan") for line in lines) > 5
    assert sum(line.startswith("  ") for line in lines) > 5


@pytest.mark.long
def test_a_package_by_the_page_alone(program, tmp_path):
    text = (ROOT / "docs/how-to/own-board.md").read_text("utf-8")
    block = re.compile(r"^`([\w.]+)`:\n\n(?:<!--[^>]*-->\n)?```\w+\n(.*?)^```$", re.M | re.S)
    files = dict(block.findall(text))
    assert len(files) == 3
    for name, content in files.items():
        (tmp_path / name).write_text(content, "utf-8")
    install_project(tmp_path, tmp_path / "site")
    done = program("-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "pyproject.toml")
    assert done.returncode == 0, done.stdout


class TestTexture(StimulusContract):
    def make(self, profile):
        texture = lab.open_texture("grating:4mm")
        motion = lab.open_motion_over(texture, "sweep:", profile, speed_mm_s=60)
        return lab.MouseSource(texture, motion, profile, press_n=lab.reading_force_n(profile))


class TestVibration(StimulusContract):
    def make(self, profile):
        trace = lab.open_trace("tone:30Hz,9um+press:0.45N", 0.5)
        mixture = lab.mix_colors(trace, profile, st.load_kernels(profile))
        return ColorSource("a vibration", profile, mixture)
