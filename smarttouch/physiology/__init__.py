"""Model of a finger: potentials in the skin, activating functions, fibers and their spikes."""
