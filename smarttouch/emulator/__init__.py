"""Emulated boards with a model of the skin, and emulated sensors, at a port."""
