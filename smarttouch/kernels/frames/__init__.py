"""All points of a slot at once: their currents, what these do, and which points share a slot."""
