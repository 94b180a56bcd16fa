"""Reading with a fingertip: pages as letter shapes or as Braille, and tests of legibility."""
