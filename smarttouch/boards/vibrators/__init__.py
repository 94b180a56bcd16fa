"""Mechanical vibrators as a board, alone or beside electrodes."""
