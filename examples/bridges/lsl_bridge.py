"""Bridge from the Lab Streaming Layer (LSL): shows each sample of a stream, and sends markers.

    python lsl_bridge.py NAME BOARD INTENSITY [FORCE]

WARNING: LSL has no password. Anybody on this network can offer a stream with the same name, and
then control the current, up to INTENSITY and the limits of the profile.

A sample with as many numbers as there are electrodes is their activation, 0 to 1. Any other sample
is a square image, row by row, 0 (black) to 255. When a pattern pulses, the bridge sends the number
of the pattern on the stream smarttouch-markers.
"""

import sys

import numpy as np
import pylsl
from pylsl.util import LostError

import smarttouch as st


def main(name: str, board: str, intensity: str, force: str | None = None) -> None:
    """Show each sample until the stream ends."""
    print(f"WARNING: anybody on this network can control the current with a stream named {name}")
    info = pylsl.StreamInfo("smarttouch-markers", "Markers", 1, 0, "string", "smarttouch")
    markers, display = pylsl.StreamOutlet(info), st.open_display(board)
    nothing = np.zeros(len(display.profile.electrodes))

    def mark(result: st.StepResult) -> None:
        if result.sequence.slots:
            markers.push_sample([f"pattern {result.input.number}"])

    inlet = pylsl.StreamInlet(pylsl.resolve_byprop("name", name, timeout=30)[0], recover=False)
    level = float(intensity)
    with display.session(mode="RA", intensity=level, force=force, listeners=[mark]) as touch:
        while True:
            try:
                sample = np.array(inlet.pull_sample(timeout=0.5)[0] or nothing)
                if len(sample) != len(nothing):
                    sample = sample.astype(np.uint8).reshape(2 * (round(len(sample) ** 0.5),))
                touch.put(sample)
            except (ValueError, st.SourceError) as error:
                print(f"a sample was ignored: {error}")
            except LostError:
                break
    print(f"{touch.statistics.delivered} sequences with pulses")


if __name__ == "__main__":
    main(*sys.argv[1:])
