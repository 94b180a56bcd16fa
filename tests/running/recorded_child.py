"""A program that records until it is killed, or until its disk is full: ``recorded_child.py PATH
[BYTES]``.

After every step that it handed over it tells the time of the step in ns and 0, and after every
chunk 0 and how many steps the system has been given.
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

    def sync_and_tell(number):
        fsync(number)
        os.write(1, f"0 {recorder._steps}\n".encode())

    def tell(result):
        os.write(1, f"{result.input.time_ns} 0\n".encode())

    os.fsync = sync_and_tell
    try:
        st.run(
            "text:on and on and on?passes=0", "simulated:", paced=True, seconds=90,
            listeners=[recorder, tell],
        )  # fmt: skip
    except RecordingError as error:
        print(error)
        print("closed")


if __name__ == "__main__":
    main(*sys.argv[1:])
