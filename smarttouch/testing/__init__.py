"""Contract tests for boards, sources and forces of other packages."""
