"""Tests of README and docs: Python blocks run, commands exist, and the tutorial runs."""

import ast
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from sybil import Sybil
from sybil.parsers.markdown import PythonCodeBlockParser, SkipParser
from typer.core import TyperGroup
from typer.main import get_command

from smarttouch.cli import app

from .reading.real_brltty import free_port
from .support.full import WHOLE, sample
from .support.processes import PROGRAM, Forked

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
GENERATED = ROOT / "docs/reference/command-line"
PAGES = [
    README,
    ROOT / "CONTRIBUTING.md",
    ROOT / "firmware/README.md",
    ROOT / "firmware/PROTOCOL.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if GENERATED not in page.parents),
]
TUTORIAL = ROOT / "docs/first-hour.md"
PYTHON = Sybil(parsers=[PythonCodeBlockParser(), SkipParser()], path=str(ROOT))
BLOCK = re.compile(
    r"(?:^Save this as `(?P<file>[\w.]+)`[^`]*)?^```(?P<language>\w+)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
SHORT = {
    "live": ("--seconds", "1"),
    "read": ("--seconds", "1"),
    "braille-display": (str(free_port()), "--seconds", "1"),
    "experiment": ("--board", "simulated:"),
}
"""Extra arguments that shorten commands which would run for minutes or until interrupted."""


def commands(text):
    """Yield the words of each command in a block of shell code."""
    for line in text.splitlines():
        parts = (shlex.split(part, comments=True) for part in line.removeprefix("$ ").split("&&"))
        yield from filter(None, parts)


def commands_of_the_program(page):
    for block in BLOCK.finditer(page.read_text("utf-8")):
        if block["language"] in ("sh", "console", "bash"):
            for name, *words in commands(block["text"]):
                if Path(name).name == "smarttouch":
                    yield words


@pytest.mark.parametrize("page", sample(PAGES), ids=lambda page: page.stem)
def test_python_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    for example in PYTHON.parse(page).examples():
        example.evaluate()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_program_takes_each_command(page):
    """The command and its options must exist; the board that they name need not."""
    for words in commands_of_the_program(page):
        command, rest = get_command(app), list(words)
        while rest and isinstance(command, TyperGroup) and rest[0] in command.commands:
            command = command.commands[rest.pop(0)]
        if rest or not isinstance(command, TyperGroup):
            command.make_context(command.name, rest)


def run(words, folder):
    """Run a command and return its output. Skip commands that set up the reader's environment."""
    name, *rest = Path(words[0]).name, *words[1:]
    if name == "smarttouch":
        rest = ["frequency?repetitions=1" if word == "frequency" else word for word in rest]
        if "text:Hello" not in " ".join(rest):
            rest += SHORT.get(rest[0], ())
        command = [str(PROGRAM), *rest]
    elif name == "python":
        command = [sys.executable, *rest]
    elif words[0] == "pytest":
        command = [sys.executable, "-m", "pytest", *rest]
    else:
        return ""
    places = {f"XDG_{each}_HOME": str(folder / each) for each in ("CACHE", "CONFIG", "STATE")}
    with Forked(
        command, cwd=folder, env=os.environ | places | {"MPLBACKEND": "agg"}, text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as process:  # fmt: skip
        said, _ = process.communicate(timeout=300)
    assert process.returncode == 0, f"{shlex.join(words)}\n{said}"
    return said


@pytest.mark.parametrize("page", [README, TUTORIAL], ids=lambda page: page.stem)
def test_the_first_hour_goes_as_written(page, tmp_path):
    """Commands print what the page shows. Numbers may differ, and … stands for any text."""
    if page is TUTORIAL and not WHOLE:
        pytest.skip("runs for minutes: pass --full to pytest")
    said = ""
    for block in BLOCK.finditer(page.read_text("utf-8")):
        if block["file"]:
            (tmp_path / block["file"]).write_text(block["text"], encoding="utf-8")
        elif block["language"] in ("sh", "console"):
            said = plain("".join(run(words, tmp_path) for words in commands(block["text"])))
        elif block["language"] == "output":
            for line in block["text"].splitlines():
                assert all(part.strip() in said for part in plain(line).split("…")), said


def plain(text):
    return " ".join(re.sub(r"[-+−]?\d[\d.,]*", "0", text).split())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_between_files_hold(page):
    """Sphinx checks links of the built pages; this test checks links of the source files."""
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
        made = "gallery/" in target or GENERATED in (page.parent / target).resolve().parents
        assert made or (page.parent / target).exists(), target


def test_pages_are_few_and_short():
    """The limits do not apply to decisions, the changelog, generated pages and firmware pages."""
    apart = {"changes", "gallery", "index", "python", "profile-keys", "link", "firmware"}
    words = {
        page: len(page.read_text("utf-8").split())
        for page in PAGES
        if ROOT / "docs" in page.parents and "decisions" not in page.parts
        and (page.stem not in apart or page.parent.name == "safety")
    }  # fmt: skip
    assert len(words) <= 20
    assert [page.stem for page, count in words.items() if count > 900] == []
    assert len(README.read_text("utf-8").splitlines()) <= 80


def test_the_page_on_architecture_names_what_there_is():
    page = (ROOT / "docs/explanation/architecture.md").read_text("utf-8")
    named = set(re.findall(r"`((?:smarttouch|tests|examples|firmware|docs)/[\w/.-]+)`", page))
    assert len(named) > 20
    assert sorted(each for each in named if not (ROOT / each).exists()) == []


def test_the_path_of_a_frame_is_as_short_as_the_page_says():
    page = (ROOT / "docs/explanation/architecture.md").read_text("utf-8")
    lines = 0
    for path, names in re.findall(r"^\| `(smarttouch/[\w/]+\.py)`: (.*?) \|", page, re.MULTILINE):
        tops = [top for top in ast.parse((ROOT / path).read_text("utf-8")).body
                if hasattr(top, "name")]  # fmt: skip
        found = {top.name: top for top in tops} | {
            f"{top.name}.{part.name}": part
            for top in tops for part in top.body if hasattr(part, "name")
        }  # fmt: skip
        for name in re.findall(r"`([\w.]+)`", names):
            lines += found[name].end_lineno - found[name].lineno + 1
    assert 400 < lines < 700


def test_the_gallery_has_each_program_in_a_section():
    named = re.findall(r"\.\./examples/(\w+)\.py", (ROOT / "docs/gallery.md").read_text("utf-8"))
    assert sorted(named) == sorted(path.stem for path in (ROOT / "examples").glob("*.py"))


def test_modules_that_pages_name_are_there():
    text = "\n".join(page.read_text("utf-8") for page in PAGES)
    # The last part of a name can be a member of the module, or a group of entry points.
    named = set(re.findall(r"`(smarttouch(?:\.[a-z_]+)+)(?:\.[A-Z]\w*)?`", text))
    named -= {f"smarttouch.{group}" for group in ("boards", "sources", "forces", "experiments")}
    places = {name: (name, name.rpartition(".")[0]) for name in named}
    assert [
        name for name, modules in places.items()
        if not any((ROOT / module.replace(".", "/")).with_suffix(suffix).exists()
                   for module in modules for suffix in ("", ".py"))
    ] == []  # fmt: skip
