"""The documentation lists every ceiling of a limit, with its value and source."""

import re
from pathlib import Path

import pytest

from smarttouch.profile import project_ceilings

SAFETY = Path(__file__).parents[2] / "docs" / "safety" / "limits.md"
CEILINGS = {
    "current of an electrode": ("CEILING_MA", "mA"),
    "current of all electrodes in a slot": ("CEILING_TOTAL_MA", "mA"),
    "pulse width": ("CEILING_PULSE_US", "µs"),
    "charge of a pulse": ("CEILING_CHARGE_UC", "µC"),
    "charge density of a pulse": ("CEILING_DENSITY_UC_CM2", "µC/cm²"),
    "Shannon's k of a pulse": ("CEILING_SHANNON_K", ""),
    "least discharge after each pulse": ("LEAST_DISCHARGE_US", "µs"),
    "sequences a second": ("CEILING_RATE_HZ", "Hz"),
    "share of the time that current flows": ("CEILING_DUTY", ""),
    "shortest rise from zero to full intensity": ("SHORTEST_RAMP_S", "s"),
    "felt pulses of an electrode": ("CEILING_PULSES_HZ", "1/s"),
    "mean current of an electrode": ("CEILING_MEAN_MA", "mA"),
    "net current of an electrode": ("CEILING_NET_MA", "mA"),
    "longest time over which the charge of one sequence is averaged": ("BURST_S", "s"),
    "session": ("CEILING_SESSION_S", "s"),
    "charge through an electrode in a session": ("CEILING_SESSION_MC", "mC"),
    "current of all displays of a user together": ("CEILING_USER_MA", "mA"),
}


@pytest.mark.parametrize("name", CEILINGS)
def test_the_documentation_has_it_with_its_source(name):
    key, unit = CEILINGS[name]
    value = re.escape(f"{getattr(project_ceilings, key):g} {unit}".strip())
    row = rf"^\| {re.escape(name)} \| {value} \| [^|]*\w[^|]*\. \|$"
    assert re.search(row, SAFETY.read_text(encoding="utf-8"), re.MULTILINE)


def test_none_is_missing_here():
    named = {key for key, _ in CEILINGS.values()}
    others = {"CEILING_AREA_MM2", "CEILING_ELECTRODES", "ADVISORY_RMS_MA_CM2"}
    assert {each for each in vars(project_ceilings) if each.isupper()} == named | others
