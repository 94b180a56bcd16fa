"""Stimulation: a tactile image becomes a time-division scan sequence, validated as safe."""
