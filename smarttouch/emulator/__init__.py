"""Emulators of sensors, and of boards on a model of the skin, at a pseudo-terminal or TCP port."""
