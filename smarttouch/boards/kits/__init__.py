"""Drivers of published kits, which check nothing and acknowledge little."""
