"""Delivered pulses: how strongly the skin answers to them, and pictures of that."""
