"""Entry point of ``python -m smarttouch``: runs the command line."""

from smarttouch.cli import main

if __name__ == "__main__":
    main()
