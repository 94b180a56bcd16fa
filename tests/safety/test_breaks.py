"""Ways by which the first version's gate was beaten, each of which must end in a refusal now.

Those that need a process, a line or a terminal stand with what they are about: runs that are
starting and `smarttouch stop` (tests/cli/test_running.py), late packets
(tests/boards/test_late.py), replayed frames (tests/boards/middle), terminals that stop reading
and signals (tests/cli/test_stopping.py, tests/stress), files (tests/base/test_files.py,
tests/running, tests/cli/test_streams.py), and what balancing does to the class
(tests/stimulation/test_recharge.py).
"""

import dataclasses
import math

import numpy as np
import pytest
from pydantic import ValidationError

from smarttouch.base.errors import BoardError, SafetyError
from smarttouch.boards.open import make_board
from smarttouch.profile import load_profile
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits

from ..rising import open_level
from .by_hand import pulses, refused

SECOND = 10**9


def test_one_endless_pulse(opened):
    gate, _ = opened
    assert refused(gate, pulses(20, discharge_us=0, period_us=5000)) == "discharge_us"
    assert refused(gate, pulses(20, discharge_us=0)) == "discharge_us"


def test_many_pulses_on_one_electrode(opened):
    """3,600 a second, 1.73 mA on average."""
    gate, _ = opened
    assert refused(gate, pulses(18, discharge_us=20, period_us=5000)) == "mean_ma"


@pytest.mark.parametrize("kind", ["kajimoto61", "etactilekit"])
@pytest.mark.parametrize("ua_per_count", [0.00244, 0.00999, 2440.0])
def test_a_misread_unit(kind, ua_per_count):
    profile = load_profile({"kajimoto61": "kajimoto-61"}.get(kind, "etactilekit-32"))
    output = profile.output.model_copy(update={"ua_per_count": ua_per_count})
    with pytest.raises(BoardError):
        make_board(f"{kind}:/dev/nowhere", SafetyLimits.of(profile), output)


def test_an_infinite_scale_is_no_profile():
    profile = load_profile("kajimoto-61").model_dump()
    profile["output"]["ua_per_count"] = math.inf
    with pytest.raises(ValidationError):
        type(load_profile("kajimoto-61")).model_validate(profile)


def test_changed_after_the_proof(limits):
    board = make_board("memory:", limits)
    with board:
        open_level(board.send, pulses(0), limits)
        given = pulses(2)
        board.send(given)
        given.current_ua[:] = 5000
        sent = board.driver.sequences[-1]
    assert np.abs(sent.current_ua).max() == 2400
    with pytest.raises(ValueError):
        sent.current_ua.setflags(write=True)
    assert not sent.current_ua.flags.writeable


def test_claimed_time(opened):
    gate, clock = opened
    gate.restart()
    gate.check(dataclasses.replace(pulses(0), intensity=0.0, time_ns=0))
    gate.check(dataclasses.replace(pulses(1, current_ua=24, time_ns=1), intensity=0.01))
    clock.time_ns += SECOND // 1000
    assert refused(gate, pulses(1, time_ns=60 * SECOND)) == "ramp_s"
    for field in ("time_ns", "period_us"):
        bad = dataclasses.replace(pulses(1), **{field: math.nan})
        assert refused(gate, bad) == field


@pytest.mark.parametrize("name", ["rate_hz", "duty", "full_us", "total_ma", "session_s"])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
def test_limits_that_limit_nothing(limits, name, value):
    with pytest.raises(SafetyError) as error:
        dataclasses.replace(limits, **{name: value})
    assert error.value.limit == name


def test_no_ceiling_on_the_total(opened):
    table = load_profile("electric-mouse").model_dump()
    table["limits"]["total_ma"] = 1e9
    with pytest.raises(ValidationError):
        type(load_profile("electric-mouse")).model_validate(table)
    gate, _ = opened
    many = pulses(1)
    many.current_ua[0] = np.where(np.arange(64) % 2, 700, -700)
    assert refused(gate, many) == "total_ma"


def test_density_is_bounded_by_the_electrodes_area(limits):
    gate = SafetyGate(dataclasses.replace(limits, area_mm2=0.2))
    assert refused(gate, pulses(1)) == "charge_uc"


def test_a_session_ends(limits):
    gate = SafetyGate(dataclasses.replace(limits, session_s=0.55))
    open_level(gate.check, pulses(0), limits)
    gate.check(pulses(1))
    gate.check(pulses(1, time_ns=2 * SECOND))
    assert refused(gate, pulses(1, time_ns=3 * SECOND)) == "session_s"
