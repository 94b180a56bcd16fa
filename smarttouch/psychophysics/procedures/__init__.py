"""Which stimulus comes next."""
