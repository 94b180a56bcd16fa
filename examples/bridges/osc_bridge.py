"""Bridge from Open Sound Control (OSC): shows patterns of Unity, Max, TouchDesigner and others.

    python osc_bridge.py BOARD INTENSITY [FORCE]

WARNING: OSC has no password. While this program runs, anybody on this machine can control the
current, up to INTENSITY and the limits of the profile. Messages:

/smarttouch/electrodes LEVEL ...           activation of each electrode, 0 to 1
/smarttouch/image WIDTH HEIGHT GRAY ...    image, row by row, 0 (black) to 255
/smarttouch/stop                           end of the program
"""

import socket
import sys

import numpy as np
from pythonosc.osc_packet import OscPacket, ParseError

import smarttouch as st


def main(board: str, intensity: str, force: str | None = None, port: str = "9000") -> None:
    """Show each pattern that arrives, until the message ``/smarttouch/stop``."""
    print(f"WARNING: anybody on this machine can control the current at 127.0.0.1:{port}")
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
                    print(f"unknown {message.address}: use /smarttouch/electrodes, image or stop")
            except TimeoutError:
                touch.put(np.zeros(len(display.profile.electrodes)))
            except (ParseError, ValueError, TypeError, OverflowError, st.SourceError) as error:
                print(f"a message was ignored: {error}")
    print(f"{touch.statistics.delivered} sequences with pulses")


if __name__ == "__main__":
    main(*sys.argv[1:])
