"""Imaging: a frame becomes a tactile image, binarized and mapped onto the electrodes."""
