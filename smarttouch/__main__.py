"""``python -m smarttouch``: the command line."""

from smarttouch.cli import main

if __name__ == "__main__":
    main()
