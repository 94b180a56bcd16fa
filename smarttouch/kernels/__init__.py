"""Kernels: currents that stimulate one afferent class at one site, or at several sites at once."""
