"""A run in a terminal: screen, keys, signals, progress, and files at its end."""
