"""General modules used by all packages: errors, files, clocks, stopping, URLs and ports."""

__version__ = "1.0.0rc1"
