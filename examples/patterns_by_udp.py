"""
Patterns from another program
=============================

Another program sends electrode numbers by UDP. Each number is shown at once. If no number arrives
for half a second, the current is zero.
"""

import socket
import threading
import time

import numpy as np

import smarttouch as st


def send(port: int, count: int = 60) -> None:
    """Simulate the other program: send an electrode number 60 times per second."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        for number in range(count):
            line.sendto(bytes([24 + number % 8]), ("127.0.0.1", port))
            time.sleep(1 / 60)


# %%
# Receive numbers and show them. With a real board, replace ``simulated:`` by ``link:PORT``. If the
# board has no force sensor, also pass ``force="fixed:0.9"`` to `session`.
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
print(f"{touch.statistics.delivered} sequences with pulses, {touch.statistics.slots} slots")
