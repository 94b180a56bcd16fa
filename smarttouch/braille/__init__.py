"""Braille: texts into cells and back, files of cells, and cells found on photographs."""
