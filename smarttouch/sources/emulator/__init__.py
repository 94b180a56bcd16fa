"""Sensors without hardware: a process of its own behind a pseudo-terminal."""
