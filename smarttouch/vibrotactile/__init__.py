"""Tactile primary colors: a vibration split into what RA, SAI and PC answer, and mixed again."""
