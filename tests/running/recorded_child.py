"""Program that records a run until the program is killed: ``recorded_child.py PATH [BYTES]``.

The file cannot grow beyond BYTES, which simulates a full disk. The program prints ``TIME_NS 0``
after each step. After each sync it prints ``0 STEPS``, where STEPS counts the steps in the file.
"""

import os
import resource
import sys

import smarttouch as st
from smarttouch.base.errors import RecordingError


def main(path, most_bytes=None):
    if most_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(most_bytes),) * 2)
    recorder, fsync = st.Recorder(path), os.fsync

    def sync_and_print(number):
        fsync(number)
        os.write(1, f"0 {recorder._steps}\n".encode())

    def print_time(result):
        os.write(1, f"{result.input.time_ns} 0\n".encode())

    os.fsync = sync_and_print
    try:
        st.run(
            "text:on and on and on?passes=0", "simulated:", paced=True, seconds=90,
            listeners=[recorder, print_time],
        )  # fmt: skip
    except RecordingError as error:
        print(error)
        print("closed")


if __name__ == "__main__":
    main(*sys.argv[1:])
