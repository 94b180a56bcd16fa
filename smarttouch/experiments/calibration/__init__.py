"""Calibration of one device on one finger, and the profile that stores it."""
