"""Conversion of tactile images to scan sequences. The safety gate proves that each sequence keeps
all limits before it is sent."""
