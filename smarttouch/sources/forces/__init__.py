"""Sources of finger force: fixed, recorded, or a load cell."""
