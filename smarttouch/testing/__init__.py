"""Contract tests that drivers of others can run, and the pytest plugin."""
