"""Calibration of one device on one finger, and the profiles that store it."""
