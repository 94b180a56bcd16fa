"""A tactile image becomes a time-division scan sequence, and is proved safe."""
