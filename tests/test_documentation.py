"""README and docs: Python blocks run as they stand, and every command is one the program takes."""

import re
import shlex
from pathlib import Path

import pytest
from typer.core import TyperGroup
from typer.main import get_command

from smarttouch import RunConfig
from smarttouch.cli import app
from smarttouch.running.saved import SavedRun, save_run

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
GENERATED = {"command-line.md"}
PACKAGES = {"own-board.md", "own-source.md"}
"""Pages whose blocks are files of a package, which tests/testing/test_docs.py builds."""

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(*languages):
    for page in PAGES:
        for language, text in BLOCK.findall(page.read_text("utf-8")):
            if language in languages and page.name not in GENERATED:
                yield page, text


def commands():
    """Yield each line of a shell block that starts the program, without its comment."""
    for page, text in blocks("sh", "console"):
        for line in text.replace("\\\n", " ").splitlines():
            for part in line.removeprefix("$ ").split("&&"):
                words = shlex.split(part, comments=True)
                if words and Path(words[0]).name == "smarttouch":
                    yield pytest.param(words[1:], id=f"{page.name}: {' '.join(words[1:])}")


PYTHON = [
    pytest.param(text, id=f"{page.name}: {text.splitlines()[0]}")
    for page, text in blocks("python")
    if page.name not in PACKAGES
]


def test_readme_is_short():
    assert len(README.read_text("utf-8").splitlines()) <= 160


@pytest.mark.parametrize("command", [
    "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/smarttouch live",
    "python3 -m venv .venv && .venv/bin/pip install -e '.[test]' && .venv/bin/pytest",
])  # fmt: skip
def test_readme_has_the_two_commands(command):
    assert f"\n```sh\n{command}\n```\n" in README.read_text("utf-8")


def test_there_is_something_to_try():
    assert len(PYTHON) >= 5
    assert len([*commands()]) >= 50


@pytest.mark.parametrize("code", PYTHON)
def test_python_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    found = {}
    exec(compile(code, "page", "exec"), found)
    if "statistics" in found:
        assert found["statistics"].figures["emulator_violations"] == 0
        assert next(tmp_path.glob("*.mcap")).stat().st_size > 10_000
    if "step" in found:
        assert found["step"].sequence.current_ua.shape[1] == 64


@pytest.mark.parametrize("words", [*commands()])
def test_the_program_takes_it(words, tmp_path, monkeypatch):
    """The command and its options exist; a board that they name may not."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    save_run("desk", SavedRun(source="camera:0", board="emulator:", config=RunConfig()))
    command, rest = get_command(app), list(words)
    while rest and isinstance(command, TyperGroup) and rest[0] in command.commands:
        command = command.commands[rest.pop(0)]
    if rest or not isinstance(command, TyperGroup):
        command.make_context(command.name, rest)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_files_hold(page):
    """Sphinx looks after links of docs; this is for those who read the files where they lie."""
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
        if "gallery/" not in target and Path(target).name not in GENERATED:
            assert (page.parent / target).exists(), target
