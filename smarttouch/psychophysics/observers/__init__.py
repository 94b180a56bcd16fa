"""Simulated observers, which answer in place of a person."""
