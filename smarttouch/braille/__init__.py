"""Braille: translation of texts, files of cells, and recognition on photographs."""
