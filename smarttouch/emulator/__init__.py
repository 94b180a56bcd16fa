"""Emulated boards on a model of the skin, and emulated sensors, behind a port."""
