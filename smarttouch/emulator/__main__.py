"""Command ``python -m smarttouch.emulator URL``, for programs that start an emulator. It does the
same as ``smarttouch devices emulate URL``, but prints only the name of the port."""

import sys

from smarttouch.base.errors import SmartTouchError
from smarttouch.emulator.devices import emulate


def main() -> None:
    """Emulate the device of the URL on the command line; exit with status 2 on an error."""
    try:
        if len(sys.argv) != 2:
            raise SmartTouchError("give the URL of one device, for example link?electrodes=16")
        emulate(sys.argv[1])
    except SmartTouchError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
