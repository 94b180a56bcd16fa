"""All points of a slot at once: currents, side effects, and assignment of points to slots."""
