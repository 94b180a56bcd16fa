"""Psychophysics: procedures, trials, answers, and the psychometric functions fitted to them."""
