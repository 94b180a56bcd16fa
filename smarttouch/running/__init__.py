"""Runs of a source on a display: runner, loop, listeners and recordings."""
