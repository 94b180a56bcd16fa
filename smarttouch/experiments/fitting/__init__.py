"""Fits of psychometric functions: thresholds, their intervals, and reasons why there is none."""
