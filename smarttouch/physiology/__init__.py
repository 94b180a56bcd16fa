"""Physics of the skin: potentials, afferent pathways, the activating function."""
