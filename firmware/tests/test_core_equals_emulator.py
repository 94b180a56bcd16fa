"""The C core and the Python emulator answer equal bytes with equal bytes and pulses."""

from collections import Counter

import numpy as np
import pytest

from firmware.tests.builds_and_machines import library
from firmware.tests.core_and_emulator import Both, Core, Emulated, Talk, Worn
from firmware.tests.random_histories import Scene, random_lists, random_table, sequence_of
from smarttouch.base.wire.framing import Deframer
from smarttouch.boards import link as protocol
from smarttouch.boards.link import MessageKind, Refusal
from smarttouch.boards.link.sequence_encoding import KernelImage


@pytest.fixture
def make_core():
    """Return a function that makes a board of the C core."""
    cores = []

    def make(*given, **named):
        cores.append(Core(library(), *given, **named))
        return cores[-1]

    yield make
    for core in cores:
        core.close()


@pytest.mark.parametrize("output", ["weighted", "three-state", "one-against-all"])
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(each, marks=pytest.mark.long) for each in (1, 2, 3))]
)
def test_answers_and_pulses_are_the_emulators(make_core, output, seed):
    ramp_ms = (0, 500)[seed % 2]
    boards = emulated, core = Emulated(6, output, ramp_ms), make_core(6, output, ramp_ms)
    # On the emulator's skin, impedances divide the current of a source; the core has no skin.
    both = Both(*boards, felt=output == "weighted")
    Scene(both, seed, output=output, ramp_ms=ramp_ms).play(150)
    books = both.books()
    assert books["slots"] >= 10
    ended, begun = both.recharges
    assert [each for each in ended if each not in begun] == []
    assert books["violations"] > 5
    assert books["framing_errors"] > 2
    driven_pc = core.driven_pc()
    assert max(map(abs, driven_pc)) > 1000
    if output == "weighted":
        # The charge includes recharge phases that were cut short.
        np.testing.assert_allclose(driven_pc, emulated.driven_pc(), atol=0.5)


@pytest.mark.parametrize("output", ["weighted", "three-state", "one-against-all"])
def test_voltages_and_charge_are_the_emulators(make_core, output):
    """With equal skin models, core and emulator report equal voltages and remaining charges."""
    core = make_core(6, output, 0).wear(Worn(6, output != "weighted"))
    boards = Emulated(6, output, 0, worn=True), core
    # On switched boards the core reports equal shares of the source current; the emulator does not.
    both = Both(*boards, felt=output == "weighted")
    scene = Scene(both, 3, output=output, worn=True)
    scene.play(60)
    scene.talk.say(MessageKind.STATUS)
    found = Counter(packet.kind for packet in Deframer().feed(both.said))
    assert found[MessageKind.VOLTAGES] > 10
    assert found[MessageKind.REPORT] > 0


def test_no_table_passes_for_another(make_core):
    """A proof holds for one table in one session. A table with a false identity is refused."""
    rng = np.random.default_rng(0)
    image, other = (KernelImage.of(random_table(rng, 4, 6), 1 << 20, 9) for _ in range(2))
    talk = Talk(Both(Emulated(6), make_core(6)))
    proofs = []
    for _ in range(2):
        talk.begin(image=image)
        (kept,) = talk.say(
            MessageKind.KERNELS, payload=protocol.KERNELS.pack(image.identity, len(image.data), 0)
        )
        identity, _, whole, proof = protocol.KEPT.unpack(kept.payload)
        assert (identity, whole) == (image.identity, 1)
        assert proof == protocol.digest_of(image.data, talk.host.number)
        proofs.append(proof)
        talk.say(MessageKind.STOP)
    assert proofs[0] != proofs[1]
    talk.begin()
    head = protocol.KERNELS.pack(image.identity[::-1], len(other.data), 0)
    (kept,) = talk.say(MessageKind.KERNELS, payload=head + other.data)
    assert kept.payload == bytes(protocol.KEPT.size)


def test_silence_is_zero_within_100_ms(make_core):
    core = make_core(6, ramp_ms=0)
    scene = Scene(core, 1)
    talk = scene.talk.begin(scene.limits)
    lists = random_lists(scene.rng, random_table(scene.rng, 4, 6), 4)
    sequence = sequence_of(lists, sums=None)
    talk.send(sequence, 1, times=1000)
    talk.wait(99_999)
    assert core.reason == "driving"
    talk.wait(1)
    assert core.reason == "silence"
    talk.wait(500_000)
    assert core.reason == "silence"


@pytest.fixture
def driving(make_core):
    """Return a core in real time, its host, and a sequence of four slots."""
    core = make_core(6, ramp_ms=0, played=False)
    scene = Scene(core, 1)
    lists = random_lists(scene.rng, random_table(scene.rng, 4, 6), 4)
    return core, scene.talk.begin(scene.limits), sequence_of(lists, sums=None)


def test_in_real_time_scans_that_were_missed_are_not_made_up_for(driving):
    core, talk, sequence = driving
    talk.send(sequence, 1, times=1000)
    starts = [each[4] for each in talk.pulses]
    starts += [each[4] for now_us in range(0, 20_000, 50) for each in core.advance(now_us)[1]]
    # The loop pauses for six periods; after that, scans keep their period.
    starts += [each[4] for now_us in range(80_000, 98_000, 50) for each in core.advance(now_us)[1]]
    missed = [each for each in starts if each >= 80_000]
    assert len(missed) == 8
    assert missed[4] - missed[0] >= 3 * sequence.period_us / 4
    assert len(starts) == 16


def test_a_fault_of_the_port_ends_the_session(driving):
    core, talk, sequence = driving
    talk.send(sequence, 1, times=1000)
    assert talk.pulses != []
    core.zero()
    assert core.reason == "fault"
    (refused,) = talk.send(sequence, 2)
    assert protocol.NAK.unpack(refused.payload)[0] == Refusal.STOPPED
    assert core.advance(10_000)[1] == []
