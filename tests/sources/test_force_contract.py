"""The contract of sources of force, run over the kinds that there are."""

import pytest

from smarttouch.sources.force import open_force
from smarttouch.testing.source_contracts import ForceContract


class Contract(ForceContract):
    """The contract of a source of force of a URL; `nowhere` is one that is not there."""

    url = nowhere = ""

    def make(self, profile):
        return open_force(self.url, profile)

    def make_impossible(self, profile):
        open_force(self.nowhere, profile)


class TestFixed(Contract):
    url, nowhere = "fixed:0.5", "fixed:hard"


class TestLoadCell(Contract):
    nowhere = "hx711:/dev/nothing"

    @pytest.fixture
    def profile(self, profile, changed):
        # Grams into newtons.
        return changed(profile, {"force.curve": (0.0, 0.00980665)})

    @pytest.fixture(autouse=True)
    def _cell(self, make_device):
        cell = make_device(lambda number: b"Reading: %d g\r\n" % (50 + number % 2))
        self.url = f"hx711:{cell.line.name}?baud=115200"
