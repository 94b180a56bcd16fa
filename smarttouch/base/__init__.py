"""Base of all packages: errors, files, clocks, stopping and names, but nothing about touch."""

__version__ = "1.0.0rc1"
