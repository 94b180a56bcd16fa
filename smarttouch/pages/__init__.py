"""Pages from image files and documents: scale in millimeters, lines of text and reading order."""
