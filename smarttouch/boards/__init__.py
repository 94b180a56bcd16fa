"""Boards and their drivers, which send proved scan sequences; run registry and shutdown."""
