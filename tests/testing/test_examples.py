"""The packages of the examples, and those that the how-tos write, work."""

import subprocess
import sys
from pathlib import Path

import pytest

from ..documented import ROOT, Reader
from ..installed import install_project
from ..whole import sample

EXAMPLES = Path(__file__).parents[2] / "examples" / "plugins"


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Return what runs Python where both are installed."""
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


@pytest.mark.parametrize("name", sample(["board", "source", "stimulus"], 3))
def test_their_own_tests_pass(program, name):
    options = ("-q", "-W", "error", "-p", "no:cacheprovider", "-c", "pyproject.toml")
    done = program("-m", "pytest", *options, folder=EXAMPLES / name)
    assert done.returncode == 0, done.stdout


def test_a_run_with_both(program, tmp_path):
    done = program(
        "-c", "from smarttouch.cli import main; main()", "live", "--board", "journal:run.txt",
        "bar:1.5?speed_mm_s=50", "--seconds", "0.5", "--force", "fixed:1", "--quiet",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = (tmp_path / "run.txt").read_text("utf-8").splitlines()
    assert lines[0] == lines[-1] == "zero"
    assert sum(line.startswith("scan") for line in lines) > 5
    assert sum(line.startswith("  ") for line in lines) > 5


@pytest.mark.parametrize(("page", "commands"), sample([("own-board", 1), ("own-source", 2)]))
def test_a_package_by_the_page_alone(page, commands, tmp_path):
    reader = Reader(tmp_path)
    reader.read(ROOT / "docs" / "how-to" / f"{page}.md")
    assert len(reader.done) == commands
    assert len([*(tmp_path / page).glob("*.py")]) == 2
