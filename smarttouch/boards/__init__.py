"""Boards and their drivers, which send proved scan sequences; and stopping of boards."""
