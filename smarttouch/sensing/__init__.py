"""Where frames come from: a finger over a page, and later cameras and files."""
