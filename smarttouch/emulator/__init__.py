"""Emulators at a pseudo-terminal or TCP port: sensors, and boards that drive a model of skin."""
