"""The packages of the how-tos, written by nothing but their code blocks, work."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ..installed import install_project

DOCS = Path(__file__).parents[2] / "docs" / "how-to"
BLOCK = re.compile(r"^`([\w.]+)`:\n\n```\w+\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", ["own-board", "own-source"])
def test_a_package_by_the_page_alone(page, tmp_path, monkeypatch):
    project, place = tmp_path / "project", tmp_path / "site"
    project.mkdir()
    place.mkdir()
    blocks = BLOCK.findall((DOCS / f"{page}.md").read_text("utf-8"))
    assert len(blocks) == 3
    for name, text in blocks:
        (project / name).write_text(text, encoding="utf-8")
    install_project(project, place)
    monkeypatch.setenv("PYTHONPATH", str(place), prepend=":")
    done = subprocess.run(
        [
            sys.executable, "-m", "pytest", "-q", "-W", "error", "-p", "no:cacheprovider",
            "-c", "pyproject.toml",
        ],
        cwd=project, capture_output=True, text=True, timeout=110, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
