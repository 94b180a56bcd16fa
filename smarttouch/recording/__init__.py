"""Recordings of runs: write, read, replay, check, repair and export."""
