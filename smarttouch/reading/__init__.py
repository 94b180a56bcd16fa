"""Reading with a fingertip: pages as letter shapes or as Braille, and how well it can be read."""
