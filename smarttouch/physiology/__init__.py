"""The physics under the skin: potentials, afferent pathways, the activating function."""
