"""Psychometric functions through answers, and what can be said of them."""
