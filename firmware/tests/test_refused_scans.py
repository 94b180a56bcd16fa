"""The C core refuses the same scans as the model of refusals; a core that lacks a rule fails."""

import ctypes
import hashlib
import itertools

import numpy as np
import pytest

from firmware.tests.builds_and_machines import changed, library
from firmware.tests.core_and_emulator import Both, Core, Emulated
from firmware.tests.host_without_gate import (
    ELECTRODES,
    LIVES,
    Life,
    charge,
    felt,
    limits,
    net,
    often,
    one_source,
    parts,
    recharge,
    rise,
    rising_parts,
    session,
)
from firmware.tests.refusal_model import FULL, Limits, Scan
from smarttouch.boards import link as protocol
from smarttouch.boards.link import MessageKind, Refusal
from tests.support.full import WHOLE as IS_WHOLE
from tests.support.full import sample

SCANS = 2500 if IS_WHOLE else 150
"""Number of scans in each of four random histories."""


@pytest.fixture
def make_life():
    cores = []

    def make(built, seed=0, output="weighted", ramp=True, both=False):
        given = ELECTRODES, output, 500 if ramp else 0
        board = core = Core(built, *given)
        cores.append(core)
        if both:
            board = Both(Emulated(*given), core, felt=output == "weighted")
        return Life(board, seed, output, ramp)

    yield make
    for core in cores:
        core.close()


@pytest.mark.parametrize("ramp", [False, True], ids=["full", "rise"])
@pytest.mark.parametrize("output", ["weighted", "three-state"])
def test_emulator_and_core_refuse_what_the_judge_refuses(make_life, output, ramp):
    life = make_life(library(), int(ramp), output, ramp, both=True).play(SCANS)
    assert life.decided[None] > SCANS // 10
    assert len(life.decided) > 6


def lived(make_life, built, play, both=False):
    """Run one of `LIVES` on a core, built as a library; if ``both``, also on the emulator."""
    output = "three-state" if play is one_source else "weighted"
    return play(
        make_life(built, output=output, ramp=play in (rise, limits, rising_parts), both=both)
    )


@pytest.mark.parametrize("play", sample(LIVES))
def test_each_rule_at_its_edge(make_life, play):
    lived(make_life, library(), play, both=True)


RULES, LAST, LEVEL = "st_rules.c", "st_exposure.c", "st_limits.c"
MUTANTS = {
    "sign of a recharge phase": (
        recharge, RULES, "if (!recharge_takes_back(", "if (0 && !recharge_takes_back("
    ),
    "discharge after a recharge phase": (
        recharge, RULES, "recharge_us + ST_MIN_DISCHARGE_US", "recharge_us"
    ),
    "duty of a recharge phase": (
        recharge, RULES, "flowed_us + sequence->recharge_us", "flowed_us"
    ),
    "felt pulses in a period": (
        felt, RULES, "(uint64_t)felt > allowed", "(uint64_t)felt > 2u * allowed"
    ),
    "felt pulses in a second": (felt, LAST, "{ ST_MAX_FELT_HZ,", "{ 2u * ST_MAX_FELT_HZ,"),
    "charge in a second": (charge, LAST, " ST_MAX_SECOND_PC,", " 2u * ST_MAX_SECOND_PC,"),
    "net charge in a second": (net, LAST, " ST_MAX_NET_PC }", " 2u * ST_MAX_NET_PC }"),
    "net charge of the last passes": (
        net, LAST, "after_pc + each->most_pc[at]", "after_pc + each->sum_pc[at]"
    ),
    "scans in a second": (often, LAST, "if (value > allowed)", "if (value > 2u * allowed)"),
    "time of the session": (
        session, LAST, "flowing_us += sequence->slots > 0u ? sequence->period_us : 0u",
        "flowing_us += 0u"
    ),
    "charge of the session": (
        session, LAST, "session_pc += load->charge_pc", "session_pc += 0u"
    ),
    "only current raises the level": (rise, LEVEL, "if (sequence->strength > 0u)", "if (true)"),
    "the level is limited by strength": (
        rise, LEVEL, "st_least(ramp->strength, ramp->level + rises)", "ramp->level + rises"
    ),
    "the strength is limited by charge": (
        rise, LEVEL, "st_least(intensity, ST_STRENGTH * share)", "intensity"
    ),
    "time without current ends a level": (
        rise, LEVEL, "passed_us - *flowing_us > ST_LEVEL_KEPT_US", "false"
    ),
    "limit of the full current": (
        limits, LEVEL, "st_least(st_u16(payload + 10), ST_MAX_CURRENT_UA)", "st_u16(payload + 10)"
    ),
    "limit of the rounding error": (
        limits, LEVEL, "(electrodes + 1u) / 2u + 1u", "5000u"
    ),
    "safe ramp if the host states none": (
        limits, LEVEL, "given_ms == 0u ? ST_SAFE_RAMP_MS : given_ms", "given_ms"
    ),
    "duration of earlier parts": (
        parts, RULES, "scan->busy_us += sequence->busy_us", "scan->busy_us = 0"
    ),
    "time with current in earlier parts": (
        parts, RULES, "scan->flowing_us += sequence->flowing_us", "scan->flowing_us = 0"
    ),
    "charge of earlier parts": (
        parts, RULES, "st_goes_on(sequence) ? board->config.each[each].scan_pc", "false ? 0u"
    ),
    "felt pulses of earlier parts": (
        parts, RULES, "st_goes_on(sequence) ? board->config.each[each].scan_felt", "false ? 0u"
    ),
    "strongest earlier part": (rising_parts, RULES, "board->scan.peak_pc > most.peak_pc", "false"),
    "part of another scan": (parts, RULES, "(!board->scan.open ||", "(false ||"),
    "whole current of one source": (
        one_source, RULES, "? total_ua : st_magnitude(", "? share[0] : st_magnitude("
    ),
}  # fmt: skip
USUAL = ("net charge of the last passes",)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name in USUAL else pytest.mark.long) for name in MUTANTS],
)
def test_a_core_without_one_rule_is_found_out(make_life, tmp_path, name):
    play, *change = MUTANTS[name]
    options = ("-DST_FOR_TESTS", "-fPIC", "-shared", "ports/host/st_library.c")
    built = changed(tmp_path, *change, *options)
    with pytest.raises(AssertionError):
        lived(make_life, built, play)


def test_the_switch_ends_what_flows(make_life):
    """No pulse begins after the emergency switch opens, not even when it closes again."""
    life = make_life(library(), both=True).begin(Limits())
    talk, scan = life.talk, Scan(20_000, [(100, 40, (3, -3, 0, 0))] * 20, 50, 0)
    reasons = []

    def refusal(answers):
        (refused,) = (each for each in answers if each.kind == MessageKind.NAK)
        reasons.append(protocol.NAK.unpack(refused.payload)[0])
        return refused

    talk.say(MessageKind.SEQUENCE, 1, scan.payload())
    talk.wait(1000, 100)
    assert talk.pulses
    life.core.switch(True)
    nak = refusal(talk.wait(100, 100))
    assert (nak.about, nak.state, talk.pulses) == (0, 1, [])
    refusal(talk.say(MessageKind.SEQUENCE, 2, scan.payload()))
    assert {each.state for each in talk.wait(50_000)} == {1}
    talk.begin()
    assert not talk.host.begun
    life.core.switch(False)
    talk.wait(40_000)
    assert talk.pulses == []
    # BEGIN of the same session now succeeds, because its challenge is still valid.
    talk.say(MessageKind.BEGIN)
    assert talk.host.begun
    talk.say(MessageKind.LIMITS, payload=Limits().payload())
    (begun,) = talk.say(MessageKind.SEQUENCE, 1, scan.payload())
    assert (begun.kind, begun.state) == (MessageKind.ACK, 0)
    assert reasons == [Refusal.EMERGENCY] * 2


SWITCHED = [*itertools.product([10, 4000], [0, 70, 2790, 3000, 11_000, 19_990, 20_000, 99_000])]
OFTEN = [SWITCHED[each] for each in (1, 2, 4, 5, 8, 11, 14)]


@pytest.mark.parametrize(
    ("look_us", "at_us"),
    [pytest.param(*each, marks=[] if each in OFTEN else pytest.mark.long) for each in SWITCHED],
)
def test_at_whatever_time_the_switch_opens(make_life, at_us, look_us):
    life = make_life(library(), ramp=False, both=True).begin(Limits())
    talk, (emulated, core) = life.talk, life.core.boards
    scan = Scan(20_000, [(100, 40, (900, -900, 0, 0))] * 20, 25, FULL, 9000, (-170, 170, 0, 0))
    (begun,) = talk.say(MessageKind.SEQUENCE, 1, scan.payload())
    assert begun.kind == MessageKind.ACK
    assert talk.say(MessageKind.SEQUENCE, 2, scan.payload()) == []
    talk.wait(at_us, 10)
    life.core.switch(True)
    answers = talk.wait(40_000, look_us)
    assert talk.pulses == []
    assert sum(each.kind == MessageKind.NAK for each in answers) == 1
    driven_pc = core.driven_pc()
    np.testing.assert_allclose(driven_pc, emulated.driven_pc(), atol=0.5)
    talk.wait(200_000)
    assert core.driven_pc() == driven_pc


@pytest.mark.parametrize("piece", sample([1, 7, 64, 1000], 3))
def test_sha_256(piece):
    """Examples of FIPS 180-4, and all lengths up to 129 bytes (a block has 64 bytes)."""
    core = ctypes.CDLL(str(library()))
    every = [b"abc", b"abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq", b"a" * 1_000_000]
    for data in every[: 2 + (piece == 1000)] + [bytes(range(size)) for size in range(130)]:
        digest = ctypes.create_string_buffer(16)
        size, each = ctypes.c_size_t(len(data)), ctypes.c_size_t(piece)
        core.st_rig_hash(data, size, each, digest)
        assert digest.raw == hashlib.sha256(data).digest()[:16]
