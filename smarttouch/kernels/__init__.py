"""Kernels: current patterns that stimulate one afferent class alone."""
