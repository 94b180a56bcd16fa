"""Tests of the public names: their number, docstrings, examples, imports and types."""

import ast
import doctest
import importlib.util
import inspect
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import smarttouch as st
from smarttouch import lab, plugins, testing, types

from .public_api import names_of


def test_they_are_few_and_all_described():
    names = [name for name in dir(st) if not name.startswith("_")]
    assert len(names) <= 45
    for name in names:
        described = inspect.getdoc(getattr(st, name))
        assert described, name
        assert described.split("\n")[0].endswith("."), name
    with pytest.raises(AttributeError):
        _ = st.nothing


@pytest.mark.parametrize("name", [each for each in st.__all__ if not each.startswith("_")])
def test_every_function_has_an_example_that_runs(name):
    tests = [
        each for each in doctest.DocTestFinder().find(getattr(st, name), name) if each.examples
    ]
    for each in tests:
        assert doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(each).failed == 0
    assert tests or not inspect.isfunction(getattr(st, name))


def test_importing_it_imports_nothing_heavy():
    """Importing the command line and the pytest plug-in does not load heavy libraries either."""
    code = (
        "import sys, smarttouch; print(*sys.modules); "
        "import smarttouch.cli, smarttouch.testing.pytest_plugin; print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    library, program = (set(line.split()) for line in done.stdout.splitlines())
    heavy = {"numpy", "cv2", "scipy", "pydantic", "serial", "mcap", "skimage", "PIL", "matplotlib"}
    assert library & (heavy | {"typer", "rich"}) == program & heavy == set()


def test_steps_without_a_board_are_those_of_a_run():
    profile, sent = st.load_profile("electric-mouse"), []
    display = st.open_display("simulated:", profile)
    st.run(st.open_source("text:touch", profile, speed_mm_s=200), display, listeners=[sent.append])
    stepped = list(st.steps(st.open_source("text:touch", profile, speed_mm_s=200), profile))
    assert len(stepped) == len(sent) > 10
    for ours, run in zip(stepped, sent, strict=True):
        np.testing.assert_array_equal(ours.sequence.current_ua, run.sequence.current_ua)
        np.testing.assert_array_equal(ours.tactile.activation, run.tactile.activation)


def test_objects_show_themselves_in_a_line():
    profile, results = st.load_profile("electric-mouse"), []
    kernel = st.design_kernel(st.load_profile("line-8"), "RA", 3)
    display = st.open_display("simulated:", profile)
    source = st.open_source("text:a", profile)
    statistics = st.run(source, display, seconds=0.1, listeners=[results.append])
    result = results[-1]
    with display.session() as touch:
        shown = touch.show(np.eye(64, dtype=np.float32)[27], 0.1)
    for each in (
        profile, profile.electrodes, st.load_kernels(profile), kernel,
        display, display.board, source, statistics, result, result.step, result.sequence,
        result.tactile, result.input, touch, shown, st.SafetyLimits.of(profile), st.RunConfig(),
    ):  # fmt: skip
        text = repr(each)
        assert type(each).__name__ in text
        assert len(text) < 320
        assert "\n" not in text
        assert " at 0x" not in text
    plain = (str, int, float, bool, type(None), list, dict)
    assert all(type(each) in plain for each in statistics.figures.values())


ROOT = Path(__file__).parents[1]
MODULES = {"types": types, "plugins": plugins, "testing": testing, "lab": lab}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PROGRAMS = [*(ROOT / "examples").glob("*.py"), *(ROOT / "examples" / "plugins").rglob("*.py")]


PUBLIC = {
    "smarttouch": names_of(st) | {*MODULES},
    **{f"smarttouch.{each}": names_of(module) for each, module in MODULES.items()},
}


def test_all_are_on_the_page_in_the_part_of_their_module():
    page = (ROOT / "docs" / "reference" / "python.md").read_text("utf-8")
    heads = {"types": "Types", "plugins": "Plug-ins", "testing": "Tests of plug-ins",
             "lab": "Laboratory", "": "At the top"}  # fmt: skip
    for module, head in heads.items():
        part = re.search(rf"^## {head}\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)[1]
        named = {*re.findall(r"^   (\w+)$", part, re.MULTILINE), *re.findall(r"`(\w+)`", part)}
        assert names_of(MODULES.get(module, st)) - named == set(), head


def imported(code):
    """Yield module and name of each import of a program; the name is None for ``import m``."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            for each in node.names:
                yield each.name, None
        elif isinstance(node, ast.ImportFrom) and node.module:
            for each in node.names:
                yield node.module, each.name


def test_examples_and_pages_import_public_names_alone():
    blocks = [(path.stem, path.read_text("utf-8")) for path in PROGRAMS]
    for page in PAGES:
        fences = re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)
        blocks += [(page.stem, each) for each in fences]
    assert len(blocks) > 35
    inside = [
        (where, module, name)
        for where, code in blocks
        for module, name in imported(code)
        if module.partition(".")[0] == "smarttouch"
        and name not in PUBLIC.get(module, ())
        and not (name is None and module in PUBLIC)
    ]
    assert inside == []


PROGRAM = Path(__file__).with_name("type_checker_case.py")
LINES = PROGRAM.read_text("utf-8").splitlines()
WRONG = {number for number, line in enumerate(LINES, 1) if line.endswith("# wrong")}


EXAMPLES = PROGRAM.parents[1] / "examples"
RIGHT = [
    EXAMPLES / f"{name}.py"
    for name in ("analyze_recording", "irregular_array", "own_board", "own_imaging", "own_stimulus",
                 "patterns_by_udp", "show_patterns", "two_intervals")
]  # fmt: skip
CHECKERS = [("mypy", "--strict"), ("pyright", "--pythonpath", sys.executable)]


@pytest.mark.long
@pytest.mark.parametrize("checker", CHECKERS, ids=lambda each: each[0])
def test_misspellings_are_all_that_is_found(checker):
    """A type checker reads the whole package in each run, so one run checks all programs."""
    if importlib.util.find_spec(checker[0]) is None:
        pytest.skip(f"{checker[0]} is not installed")
    if checker[0] == "pyright" and shutil.which("node") is None:
        pytest.skip("install Node.js, so that pyright does not download it")
    done = subprocess.run(
        [sys.executable, "-m", *checker, *map(str, [PROGRAM, *RIGHT])],
        capture_output=True, text=True, timeout=500, check=False, cwd=PROGRAM.parents[1],
        env=os.environ | {"PYRIGHT_PYTHON_GLOBAL_NODE": "1"},
    )  # fmt: skip
    assert len(WRONG) >= 17
    found = re.findall(r"(\w+)\.py:(\d+):.*error", done.stdout)
    assert {(name, int(line)) for name, line in found} == {
        ("type_checker_case", each) for each in WRONG
    }
    # mypy reports the number of files that it has checked.
    if checker[0] == "mypy":
        assert f"checked {1 + len(RIGHT)} source files" in done.stdout
