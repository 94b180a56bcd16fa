"""Boards and sensors without hardware: one server on a port, into which a device is plugged."""
