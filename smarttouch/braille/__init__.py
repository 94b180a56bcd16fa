"""Braille: translation between text and cells, files, and detection in pictures."""
