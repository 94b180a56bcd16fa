"""
A feed of your own
==================

Another program sends by UDP where something is; what comes is felt at once, and half a second
without it is zero current.
"""

import socket
import threading
import time

import numpy as np

import smarttouch as st


def send(port: int, count: int = 60) -> None:
    """Send an electrode, 60 times a second: the other program."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        for number in range(count):
            line.sendto(bytes([24 + number % 8]), ("127.0.0.1", port))
            time.sleep(1 / 60)


# %%
# On a real board: ``link:PORT`` in place of ``simulated:``, and ``force="fixed:0.9"`` where a
# finger presses that nothing measures.
line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
line.bind(("127.0.0.1", 0))
line.settimeout(1.0)
display = st.open_display("simulated:", "electric-mouse")
with line, display.session(mode="RA", intensity=0.6, paced=True) as touch:
    touch.rise()
    sender = threading.Thread(target=send, args=line.getsockname()[1:])
    sender.start()
    for _ in range(60):
        pattern = np.zeros(len(display.profile.electrodes), np.float32)
        pattern[line.recv(1)[0]] = 1
        touch.put(pattern, stale_s=0.5)
    sender.join()
print(f"{touch.statistics.delivered} sequences with pulses, {touch.statistics.slots} pulses")
