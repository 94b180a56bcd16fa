"""Driver of boards that speak the ``link`` protocol."""
