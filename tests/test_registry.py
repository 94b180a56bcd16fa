"""Openers are found by name; those in a group of a former name still are, and are named."""

from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest

from smarttouch import registry
from smarttouch.errors import SensorError
from smarttouch.registry import find_opener, known_openers

from .raising import raises

NEW, FORMER = "smarttouch.sources", "smarttouch.sensors"


class Owned(EntryPoint):
    """An entry point of a package."""

    dist = SimpleNamespace(name="their-package")


@pytest.fixture
def offered(monkeypatch):
    """Have these be all entry points, each a name, a function and a group."""

    def offer(*points):
        points = [Owned(*each) for each in points]
        monkeypatch.setattr(
            registry, "entry_points", lambda group: [each for each in points if each.group == group]
        )

    return offer


def test_the_package_s_own_sources_are_in_the_group():
    assert {"camera", "page", "recording", "text"} <= known_openers(NEW).keys()
    opener, rest = find_opener(NEW, "page:a:b.png", SensorError)
    assert (opener.__name__, rest) == ("open_page", "a:b.png")


def test_a_name_in_the_former_group_is_found_and_its_package_named(offered):
    offered(("theirs", "math:floor", FORMER), ("mine", "math:floor", NEW))
    with pytest.warns(DeprecationWarning, match="their-package"):
        opener, rest = find_opener(NEW, "theirs:x", SensorError)
    assert (opener(1.5), rest) == (1, "x")
    assert find_opener(NEW, "mine:y", SensorError)[1] == "y"
    with raises(SensorError, about="source", value="none:", allowed=("mine", "theirs")):
        find_opener(NEW, "none:", SensorError)


def test_the_new_group_goes_first(offered):
    offered(("page", "math:floor", NEW), ("page", "math:ceil", FORMER))
    assert find_opener(NEW, "page:x", SensorError)[0](1.5) == 1
