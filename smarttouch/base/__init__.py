"""Base of all packages: errors, files, clocks, stopping and names, but nothing about touch."""
