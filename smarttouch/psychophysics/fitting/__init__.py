"""Fits of psychometric functions: thresholds, intervals, and diagnostics."""
