"""Pictures of the design wing: the paper's figures, kernels and their activation, fibers."""
