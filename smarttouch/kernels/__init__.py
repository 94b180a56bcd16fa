"""Currents that reach one afferent class at one site, for single points and for whole frames."""
