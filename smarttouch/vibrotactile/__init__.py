"""Tactile primary colors: a vibration split into responses of RA, SAI and PC, and mixed again."""
