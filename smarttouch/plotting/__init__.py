"""Figures: the paper's, kernels and their activation, fibers, experiments."""
