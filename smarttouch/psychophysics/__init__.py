"""Psychophysics: which stimulus comes next, what was answered, and what follows from it."""
