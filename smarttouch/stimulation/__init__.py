"""A tactile image becomes a scan sequence, proved safe before a board gets it."""
