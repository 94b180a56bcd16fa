"""Tests that public names disappear only after a deprecation in an earlier release."""

import inspect

import pytest
from typing_extensions import deprecated

import smarttouch

from .public_api import MESSAGE, described, number_of, public_names, read_released, unannounced

NAMES = public_names()


def test_no_name_of_the_last_release_is_gone_unannounced():
    # Before 1.0: list removed names in CHANGELOG.md, then run python -m tests.public_api.
    before = read_released()
    assert unannounced(before, NAMES, number_of(smarttouch.__version__)) == []
    assert len(before["names"]) > 1000


def test_a_deprecation_names_its_versions_and_its_replacement():
    now = number_of(smarttouch.__version__)
    for name, message in NAMES.items():
        if message:
            since_major, since, major, minor, _ = MESSAGE.fullmatch(message).groups()
            assert (int(since_major), int(since)) <= now < (int(major), int(minor)), name


class Old:
    """Example of a class with a deprecated method."""

    @deprecated("since 1.1, removed in 2.0: use rise")
    def lift_to(self, level):
        """Do nothing."""


def test_a_deprecated_name_warns_and_is_listed_with_its_message():
    with pytest.warns(DeprecationWarning, match="use rise"):
        Old().lift_to(1)
    Old.lift_to.__module__ = "smarttouch.example"
    assert dict(described("lift_to", inspect.getattr_static(Old, "lift_to"))) == {
        "lift_to": "since 1.1, removed in 2.0: use rise", "lift_to.level": "",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("deprecated_then", "now", "gone"),
    [
        ({}, (1, 2), ["a.B", "a.B.run", "a.B.run.x"]),
        ({"a.B.run": "since 1.1, removed in 2.0: use go"}, (2, 0), ["a.B"]),
        ({"a.B": "since 1.1, removed in 2.0: use C"}, (2, 0), []),
        ({"a.B": "since 1.1, removed in 2.0: use C"}, (1, 9), ["a.B", "a.B.run", "a.B.run.x"]),
        ({"a.B": "some day"}, (2, 0), ["a.B", "a.B.run", "a.B.run.x"]),
    ],
)
def test_only_what_was_announced_for_this_version_may_go(deprecated_then, now, gone):
    before = {"names": ["a.B", "a.B.run", "a.B.run.x", "a.C"], "deprecated": deprecated_then}
    assert unannounced(before, {"a.C", "a.D"}, now) == gone
