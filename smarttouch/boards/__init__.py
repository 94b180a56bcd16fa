"""A scan sequence becomes bytes on a wire: one contract, several drivers."""
