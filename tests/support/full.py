"""Option ``pytest --full``, as in CI: run all cases of repetitive tests instead of a sample."""

WHOLE = False


def configure(config):
    """Read the option ``--full``. Call this before test modules are imported."""
    global WHOLE
    WHOLE = config.getoption("full")


def sample(cases, step=2):
    """Return all cases with ``--full``, otherwise every ``step``-th case."""
    return list(cases)[:: 1 if WHOLE else step]
