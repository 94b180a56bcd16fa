"""Show what Unity, Max, TouchDesigner and others send by Open Sound Control (OSC).

    python osc_bridge.py BOARD INTENSITY [FORCE]

WARNING: OSC has no password. While this program runs, anybody on this machine can steer the
current, up to this intensity and the limits of the profile. Messages:

/smarttouch/electrodes LEVEL ...           all electrodes, 0 to 1
/smarttouch/image WIDTH HEIGHT GRAY ...    what a sensor sees, row by row, 0 (black) to 255
/smarttouch/stop                           end the program
"""

import socket
import sys

import numpy as np
from pythonosc.osc_packet import OscPacket, ParseError

import smarttouch as st


def main(board: str, intensity: str, force: str | None = None, port: str = "9000") -> None:
    """Put each pattern that arrives, until a message asks to stop."""
    print(f"WARNING: anybody on this machine can steer the current, at 127.0.0.1:{port}")
    display = st.open_display(board)
    session = display.session(mode="RA", intensity=float(intensity), force=force)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line, session as touch:
        line.bind(("127.0.0.1", int(port)))
        line.settimeout(0.5)
        while True:
            try:
                message = OscPacket(line.recv(65536)).messages[-1].message
                if message.address == "/smarttouch/stop":
                    break
                if message.address == "/smarttouch/electrodes":
                    touch.put(np.array(message.params, np.float32))
                elif message.address == "/smarttouch/image":
                    width, height, *gray = message.params
                    touch.put(np.array(gray, np.uint8).reshape(height, width))
                else:
                    print(f"left out: {message.address}")
            except TimeoutError:
                touch.put(np.zeros(len(display.profile.electrodes)))
            except (ParseError, ValueError, TypeError, OverflowError, st.SourceError) as error:
                print(f"left out: {error}")
    print(f"{touch.statistics.delivered} sequences with pulses")


if __name__ == "__main__":
    main(*sys.argv[1:])
