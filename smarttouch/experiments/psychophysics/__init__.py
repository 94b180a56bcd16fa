"""Experiments: trials, the procedures that choose them, and simulated observers."""
