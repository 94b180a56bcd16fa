"""Show the samples of a stream of the Lab Streaming Layer (LSL), and send a marker of each.

    python lsl_bridge.py NAME BOARD INTENSITY [FORCE]

WARNING: LSL has no password. Anybody on this network can offer a stream of this name, and steer
the current up to this intensity and the limits of the profile.

A sample with a number for each electrode is activation, 0 to 1; any other is a square image of
what a sensor sees, row by row, 0 (black) to 255. The stream smarttouch-markers names each pattern
when it pulses.
"""

import sys

import numpy as np
import pylsl
from pylsl.util import LostError

import smarttouch as st


def main(name: str, board: str, intensity: str, force: str | None = None) -> None:
    """Put each sample until the stream ends."""
    print(f"WARNING: anybody on this network can steer the current, by a stream named {name}")
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
                print(f"left out: {error}")
            except LostError:
                break
    print(f"{touch.statistics.delivered} sequences with pulses")


if __name__ == "__main__":
    main(*sys.argv[1:])
