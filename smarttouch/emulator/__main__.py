"""``python -m smarttouch.emulator URL``: like ``smarttouch devices emulate``, but for programs: it
prints only the name of the port."""

import sys

from smarttouch.base.errors import SmartTouchError
from smarttouch.emulator.devices import emulate


def main() -> None:
    """Emulate the device of a URL until its host is gone."""
    try:
        if len(sys.argv) != 2:
            raise SmartTouchError("give the URL of one device, for example link?electrodes=16")
        emulate(sys.argv[1])
    except SmartTouchError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
