"""The electric mouse: a texture that stays in place while the hand moves (paper, Section IV-C)."""
