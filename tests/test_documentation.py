"""README and docs: Python blocks run as they stand, and every command is one the program takes."""

import re
from pathlib import Path

import pytest
from typer.core import TyperGroup
from typer.main import get_command

from smarttouch.cli import app

from .documented import GENERATED, PAGES, ROOT, PageError, Reader, blocks
from .forks import Forked

README = ROOT / "README.md"
BLOCKS = [block for page in PAGES for block in blocks(page)]
CONCEPTS = sorted((ROOT / "docs" / "explanation").glob("*.md"))
NOT_RUN = 32
"""Commands of all pages that `tests.documented` leaves out: tools of a checkout, compilers,
hardware, a screen."""
DRAWN = ["how-to/profiles.md"]
"""Pages that take little to run; `.ci/run` runs all, the tutorial has a test of its own."""


def commands():
    """Yield each command that starts the program."""
    for block in BLOCKS:
        for _, (program, *words), _ in block.commands():
            if Path(program).name == "smarttouch":
                yield pytest.param(words, id=f"{block.page.name}: {' '.join(words)}")


PYTHON = [
    pytest.param(block.text, id=f"{block.page.name}: {block.text.splitlines()[0]}")
    for block in BLOCKS
    if block.language == "python" and not block.file
]


def test_readme_is_short():
    assert len(README.read_text("utf-8").splitlines()) <= 110


@pytest.mark.parametrize("command", [
    "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/smarttouch live",
    "python3 -m venv .venv && .venv/bin/pip install -e '.[test]' && .venv/bin/pytest",
])  # fmt: skip
def test_readme_has_the_two_commands(command):
    assert f"\n```sh\n{command}\n```\n" in README.read_text("utf-8")


def test_there_is_something_to_try():
    assert len([block for block in BLOCKS if block.language == "python"]) >= 10
    assert len(PYTHON) >= 4
    assert len([*commands()]) >= 50


@pytest.mark.parametrize("name", DRAWN)
def test_a_page_works_as_written(name, tmp_path):
    Reader(tmp_path, Forked).read(ROOT / "docs" / name)


def test_a_wrong_page_is_reported_by_its_line(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.documented.ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("# Page\n\n```sh\nsmarttouch profiles\nsmarttouch profiles show no.toml\n```\n")
    reader = Reader(tmp_path, Forked)
    with pytest.raises(PageError, match=r"^page\.md:5: .*: 2\n"):
        reader.read(page)
    assert reader.done == [
        ["smarttouch", "profiles"],
        ["smarttouch", "profiles", "show", "no.toml"],
    ]


def test_little_is_not_run():
    left = [words for block in BLOCKS for _, words, runs in block.commands() if not runs]
    assert len(left) == NOT_RUN


@pytest.mark.parametrize("code", PYTHON)
def test_python_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    found = {}
    exec(compile(code, "page", "exec"), found)
    if "statistics" in found:
        assert found["statistics"].figures["emulator_violations"] == 0
        assert [path.stat().st_size > 10_000 for path in tmp_path.glob("*.mcap")] == [True] * (
            "Recorder" in code
        )
    if "step" in found:
        assert found["step"].sequence.current_ua.shape[1] == 64


@pytest.fixture(scope="module")
def program():
    """The command line, put together once."""
    return get_command(app)


@pytest.mark.parametrize("words", [*commands()])
def test_the_program_takes_it(words, program):
    """The command and its options exist; a board that they name may not."""
    command, rest = program, list(words)
    while rest and isinstance(command, TyperGroup) and rest[0] in command.commands:
        command = command.commands[rest.pop(0)]
    if rest or not isinstance(command, TyperGroup):
        command.make_context(command.name, rest)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_files_hold(page):
    """Sphinx looks after links of docs; this is for those who read the files where they lie."""
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
        made = "gallery/" in target or GENERATED in (page.parent / target).resolve().parents
        assert made or (page.parent / target).exists(), target


def test_the_page_on_architecture_names_what_there_is():
    root = Path(__file__).parents[1]
    page = (root / "docs" / "explanation" / "architecture.md").read_text("utf-8")
    named = set(re.findall(r"`((?:smarttouch|tests|examples|firmware|docs)/[\w/.-]+)`", page))
    assert len(named) > 30
    assert sorted(each for each in named if not (root / each).exists()) == []


@pytest.mark.parametrize("page", CONCEPTS, ids=lambda page: page.name)
def test_a_concept_is_read_in_minutes(page):
    """What was measured is under *validation*, what is looked up under *reference*."""
    assert len(re.findall(r"\w[\w'’.-]*", page.read_text("utf-8"))) <= 900


def test_the_gallery_has_each_program_in_a_section():
    named = re.findall(
        r"\.\./examples/(\w+)\.py", (ROOT / "docs" / "gallery.md").read_text("utf-8")
    )
    assert sorted(named) == sorted(path.stem for path in (ROOT / "examples").glob("*.py"))


def test_modules_that_pages_name_are_there():
    text = "\n".join(page.read_text("utf-8") for page in PAGES)
    # The last part may be a name of the module, or a group of entry points.
    named = set(re.findall(r"`(smarttouch(?:\.[a-z_]+)+)(?:\.[A-Z]\w*)?`", text))
    groups = {f"smarttouch.{group}" for group in ("boards", "sources", "forces", "experiments")}
    missing = [
        name
        for name in named - groups
        if not any(
            (ROOT / each).exists() for each in _places(name) + _places(name.rpartition(".")[0])
        )
    ]
    assert missing == []


def _places(name):
    path = name.replace(".", "/")
    return [f"{path}.py", path]
