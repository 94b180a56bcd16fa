"""State of the process while a run paces: nothing long is left to do, nothing gets in between."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

from smarttouch.running.pipeline import Pipeline


@contextmanager
def steady_environment(pipeline: Pipeline) -> Iterator[None]:
    """Warm a pipeline up, freeze garbage and keep images to one thread while the block runs.

    Before a board is open: it would take the delay for a lost host.
    """
    pipeline.warm_up()
    gc.collect()
    gc.freeze()
    threads = cv2.getNumThreads()
    # Images are small: a second thread costs more than it saves, and takes the other core.
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        gc.unfreeze()
