"""Currents become potentials in the skin, drives of fibers, and spikes of one finger."""
