"""Text becomes cells of Braille and cells become text: codes, files, and photographs."""
