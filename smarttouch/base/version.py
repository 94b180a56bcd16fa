"""Version of the package: this is the one place that says it."""

__version__ = "0.9.0"
