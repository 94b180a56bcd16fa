"""Psychophysics, calibration, and studies of many simulated fingers."""
