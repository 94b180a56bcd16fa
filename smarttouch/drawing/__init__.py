"""Patterns that a user draws, plays from a list, or sends from another program."""
