"""Runs kept in files: written while they go, read back, played, checked, mended and exported."""
