"""Pages of print: image files, printed texts, what is ink on them, and where the lines are."""
