"""Conversion of tactile images to scan sequences, which the safety gate proves before they are
sent."""
