"""Emulated display board: a process of its own behind a pseudo-terminal."""
