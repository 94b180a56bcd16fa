"""Modules that all packages use: errors, events, files, clocks, stop requests, URLs, ports."""

__version__ = "1.0.0rc1"
