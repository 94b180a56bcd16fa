"""Makes ``vectors.json``: ``python -m tests.firmware.make_vectors``.

Each is a board's life: bytes at a time in, bytes and pulses out, of the Python emulator with the
challenges 1, 2, 3 …; makers of firmware play them to theirs. Made anew only where the protocol
is meant to change.
"""

import json
from pathlib import Path

import numpy as np

from smarttouch.boards.link.protocol import MessageKind
from smarttouch.boards.link.sequence_encoding import KernelImage, encode_scan
from smarttouch.stimulation.safety_gate import SafetyLimits
from tests.firmware.rig import Both, Emulated, Talk
from tests.firmware.scenes import Scene, random_lists, random_table, sequence_of

LIMITS = SafetyLimits(4, 3.0, 200, 0.5, 200, 0.8, 0.5, 2.4)


def _talk(ramp_ms=0, output="weighted", worn=False):
    return Talk(Both(Emulated(4, output, ramp_ms, worn)))


def _handshake():
    talk = _talk().begin(LIMITS)
    talk.say(MessageKind.STATUS)
    talk.say(MessageKind.STOP)
    return talk


def _kernels():
    rng = np.random.default_rng(1)
    table = random_table(rng, 3, 4)
    image = KernelImage.of(table, 1000, 10)
    talk = _talk().begin(LIMITS, image)
    talk.send(sequence_of(random_lists(rng, table, 3)), 1, image=image)
    talk.send(sequence_of(random_lists(rng, table, 1)), 2, times=2, image=image)
    talk.wait(31_000)
    return talk


def _rise():
    talk = _talk(500).begin(LIMITS)
    for step in range(12):
        lists = random_lists(np.random.default_rng(step), _table(), 1, loud=300)
        talk.send(sequence_of(lists, sums=None, intensity=min(1.0, step / 8)), step + 1)
        talk.wait(40_000)
    return talk


def _table():
    return random_table(np.random.default_rng(2), 3, 4)


def _silence():
    talk = _talk().begin(LIMITS)
    talk.send(sequence_of(random_lists(np.random.default_rng(3), _table(), 2), sums=None), 1, 100)
    talk.wait(120_000)
    talk.say(MessageKind.STATUS)
    return talk


def _voltages():
    rng = np.random.default_rng(4)
    talk = _talk(worn=True).begin(LIMITS)
    for number, slots in enumerate((3, 0, 130), 1):
        lists = random_lists(rng, _table(), slots, loud=4000 if slots < 10 else 400)
        sequence = sequence_of(lists, sums=None, period_us=30_000)
        talk.send(sequence, number, times=2 if slots < 10 else 1, measure=True)
        talk.wait(61_000, 20_000)
        talk.say(MessageKind.STATUS)
    return talk


def _parts():
    talk = _talk().begin(LIMITS)
    scan = sequence_of(random_lists(np.random.default_rng(5), _table(), 7), sums=None)
    number = 0
    for wait_us, most_slots in ((300, 3), (20_000, 2)):
        for part in encode_scan(scan, 1, False, False, None, 1 << 20, most_slots):
            number += 1
            talk.say(MessageKind.SEQUENCE, number, part.payload)
            talk.wait(wait_us, 500)
    # A part that goes on where nothing does.
    talk.say(MessageKind.SEQUENCE, number + 1, part.payload)
    talk.wait(20_000)
    talk.say(MessageKind.STATUS)
    return talk


def _scene(output):
    talk = _talk(500 if output == "weighted" else 0, output)
    scene = Scene(talk.board, 7, 4, output, 500 if output == "weighted" else 0)
    scene.play(40)
    return scene.talk


def made():
    """Return all vectors by name."""
    lives = {
        "handshake": (_handshake(), "weighted", 0),
        "kernels": (_kernels(), "weighted", 0),
        "rise": (_rise(), "weighted", 500),
        "silence": (_silence(), "weighted", 0),
        "voltages": (_voltages(), "weighted", 0),
        "parts": (_parts(), "weighted", 0),
        "everything": (_scene("weighted"), "weighted", 500),
    }
    vectors = {}
    for name, (talk, output, ramp_ms) in lives.items():
        steps = []
        measured = iter(talk.board.boards[0].measured())
        for what, now_us, data, answer, pulses in talk.board.log:
            step = {"time_us": now_us}
            if what == "feed":
                step["bytes"] = data.hex()
            steps.append(step | {"answer": answer.hex(), "pulses": pulses})
            if name == "voltages":
                steps[-1]["measured"] = [next(measured) for _ in pulses]
        vectors[name] = {
            "electrodes": 4, "output": output, "ramp_ms": ramp_ms, "steps": steps
        }  # fmt: skip
    return vectors


if __name__ == "__main__":
    path = Path(__file__).parent / "vectors.json"
    path.write_text(json.dumps(made(), indent=None).replace("}, {", "},\n{") + "\n", "utf-8")
    print(f"{path.name}: {path.stat().st_size} bytes")
