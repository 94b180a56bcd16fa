"""What programs may use: the names at the top and in four modules, all on the page."""

import ast
import builtins
import inspect
import re
import typing
from pathlib import Path

import pytest

import smarttouch as st
from smarttouch import lab, plugins, testing, types

from .public_api import names_of

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
    """Yield module and name of all that a program imports from the package."""
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


ALL = {name: getattr(st, name) for name in PUBLIC["smarttouch"] - {*MODULES}} | {
    name: getattr(module, name) for module in (types, plugins, testing) for name in names_of(module)
}

LOCAL = {
    **ALL, **vars(builtins),
    "ClassVar": typing.ClassVar,
}  # fmt: skip
"""All that a hint may name which its module imports for type checkers alone."""


def types_in(hint):
    if isinstance(hint, type):
        yield hint
    for each in typing.get_args(hint):
        yield from types_in(each)


def functions_of(value):
    """Yield the functions whose signatures users of a name see."""
    if inspect.isfunction(value):
        yield value
    elif inspect.isclass(value) and value.__module__.startswith("smarttouch"):
        for name, member in vars(value).items():
            inner = getattr(member, "fget", None) or getattr(member, "__func__", member)
            if (not name.startswith("_") or name == "__init__") and inspect.isfunction(inner):
                yield inspect.unwrap(inner)


@pytest.mark.parametrize("name", sorted(ALL))
def test_what_its_signatures_name_is_public(name):
    value, public = ALL[name], {id(each) for each in ALL.values()}
    hints = []
    for function in functions_of(value):
        # What is imported for type checkers alone must be found among the public names.
        hints += typing.get_type_hints(function, localns=LOCAL).values()
    if inspect.isclass(value):
        shown = {each for each in getattr(value, "__annotations__", ()) if each[0] != "_"}
        found = typing.get_type_hints(value, localns=LOCAL)
        hints += [found[each] for each in shown]
    named = {each for hint in hints for each in types_in(hint)}
    inside = [
        each
        for each in named
        if each.__module__.startswith("smarttouch") and id(each) not in public
    ]
    assert inside == []
