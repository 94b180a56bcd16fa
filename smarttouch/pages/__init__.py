"""Image files and documents become pages in millimeters, with their lines of text in order."""
