"""Sources of stimuli: textures under a moving hand, vibrations in tactile primary colors, and
patterns of other programs."""
