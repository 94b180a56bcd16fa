"""A fingertip as the Braille display of a computer, by way of BRLTTY's virtual driver."""
