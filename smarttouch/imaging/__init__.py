"""A frame becomes a tactile image: ink separated from paper and averaged under every electrode."""
