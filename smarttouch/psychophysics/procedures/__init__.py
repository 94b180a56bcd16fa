"""Procedures that choose the next stimulus."""
