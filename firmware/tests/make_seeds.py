"""Seed inputs for the fuzzer: ``python -m firmware.tests.make_seeds FOLDER`` writes them.

Each input is the history of a board as a list of acts, see ``firmware/fuzz/st_fuzz.c``. Most
sequences are valid, so that pulses flow from the start.
"""

import sys
from pathlib import Path

from firmware.tests.random_histories import Scene, random_table
from smarttouch.boards.link import OUTPUTS
from smarttouch.boards.link.sequence_encoding import KernelImage

TIME, BEGIN, LIMITS, KERNELS, SEQUENCE = 0, 3, 4, 5, 6
RAMP, REAL_TIME, VOLTAGES = 0x80, 0x40, 0x20


def _act(kind, count, body=b""):
    return bytes([kind]) + count.to_bytes(2, "little") + body


def life(seed):
    """Return one input: a byte of flags, then acts."""
    number = seed % 3
    scene = Scene(None, seed, output=OUTPUTS[number], worn=bool(seed & 1))
    flags = RAMP * (seed % 7 == 0) | REAL_TIME * (seed % 5 == 0) | VOLTAGES * (seed & 1)
    # The fuzzer takes the kind of output from this byte modulo 3.
    first = next(each for each in range(flags, flags + 3) if each % 3 == number)
    scene.image = KernelImage.of(random_table(scene.rng, 9, 6), 2048, 16)
    acts = [bytes([first]), _act(BEGIN, 0), _act(LIMITS, 0)]
    acts.append(_act(KERNELS, len(scene.image.data), scene.image.data))
    for _ in range(6):
        payload = scene._payload()
        acts.append(_act(SEQUENCE, len(payload), payload))
        acts += [_act(TIME, int(scene.rng.integers(1, 20_000))) for _ in range(3)]
    return b"".join(acts)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(120):
        (folder / f"life-{seed:03}").write_bytes(life(seed))
    print(f"120 inputs in {folder}")
