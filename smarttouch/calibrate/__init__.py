"""What is measured of one device on one finger, and the profiles it is written to."""
