"""Conversion of frames to tactile images."""
