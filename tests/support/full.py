"""How much tests do that repeat one thing: with ``pytest --full``, as in CI, all of it."""

WHOLE = False


def configure(config):
    """Take ``--full``, before tests are imported."""
    global WHOLE
    WHOLE = config.getoption("full")


def sample(every, step=2):
    """Return all of several, or each so many of them."""
    return list(every)[:: 1 if WHOLE else step]
