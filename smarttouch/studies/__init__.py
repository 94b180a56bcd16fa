"""Studies: many fingers, kernels, scans and patterns in a table, on one machine or many."""
