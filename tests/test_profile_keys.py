"""Tests that the documentation has every profile key with its type, limits and meaning."""

from pathlib import Path

import pytest
from profile_keys import _tables, key_reference, key_rows

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import read_toml
from smarttouch.profile import list_profiles
from smarttouch.profile.toml_files import profile_path

REFERENCE = Path(__file__).parents[1] / "docs" / "reference" / "profile-keys.md"
TABLES = dict(_tables())


def test_the_documentation_matches_the_models():
    assert REFERENCE.read_text(encoding="utf-8") == key_reference()


@pytest.mark.parametrize("name", TABLES)
def test_every_key_has_a_type_and_a_sentence(name):
    for key, kind, _, _, _, meaning in key_rows(TABLES[name]):
        assert kind, key
        assert meaning.endswith((".", ".)")), key


@pytest.mark.parametrize("name", list_profiles())
def test_every_key_of_the_shipped_profiles_is_in_it(name):
    known = {row[0].strip("`") for table in TABLES.values() for row in key_rows(table)}

    def keys(table):
        for key, value in table.items():
            yield from keys(value) if isinstance(value, dict) else [key]

    assert set(keys(read_toml(profile_path(name), ProfileError))) <= known
