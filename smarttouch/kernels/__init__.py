"""Which current pattern stimulates one afferent class alone."""
