"""Pages of print: image files, printed texts, ink, and lines of text."""
