"""Textures under a moving hand, vibrations in three primary colors, and drawn patterns."""
