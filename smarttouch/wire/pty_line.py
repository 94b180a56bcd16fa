"""The far end of a serial port that does not exist: what emulators hang on."""

import errno
import os
import pty
import select
import time
import tty

LARGEST_READ = 65536


class PtyLine:
    """A serial port of this machine, raw from the start."""

    def __init__(self) -> None:
        self._master, slave = pty.openpty()
        self.name = os.ttyname(slave)
        # What a host writes must pass as it is, whenever it sets up its end.
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        # With our end of the slave closed, the host's last close shows as a hang-up.
        os.close(slave)

    def read(self, timeout_s: float) -> bytes | None:
        try:
            if not select.select([self._master], [], [], timeout_s)[0]:
                return b""
            return os.read(self._master, LARGEST_READ)
        except BlockingIOError:
            # A hang-up looks readable; the host has opened the port since.
            return b""
        except OSError as error:
            if error.errno == errno.EIO:
                time.sleep(0.002)
                return None
            raise

    def write(self, data: bytes) -> bytes:
        try:
            return data[os.write(self._master, data) :]
        except BlockingIOError:
            return data
        except OSError:
            return b""

    def close(self) -> None:
        """Hang up; what a host has open there is an error from now on."""
        os.close(self._master)
